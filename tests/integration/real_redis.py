"""A Redis of an operator's, as several services use one."""

import subprocess
from types import TracebackType
from typing import Self

import redis

from tests.integration.running_service import eventually, free_port


class RealRedis:
    """`redis-server` on a port, without persistence: a restart has lost everything. A context manager that ends it."""

    def __init__(self) -> None:
        self._port = free_port()
        self.url = f"redis://127.0.0.1:{self._port}"
        self.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.kill()

    def start(self) -> None:
        options = ["--port", str(self._port), "--bind", "127.0.0.1", "--save", "", "--loglevel", "warning"]
        self.process = subprocess.Popen(["redis-server", *options], stdout=subprocess.DEVNULL)
        if not eventually(self.answers, 90):
            self.kill()
            raise AssertionError("redis-server does not answer")

    def answers(self) -> bool:
        try:
            return bool(redis.Redis.from_url(self.url).ping())
        except redis.RedisError:
            return False

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
