"""The default pool: one worker process per GPU, or per CPU socket where there is none."""

from dataclasses import replace

from panoloc.service.host.process_resources import num_sockets, usable_memory_bytes, visible_gpus
from panoloc.service.pool.messages import Hello
from panoloc.service.pool.process_pool import ProcessPool, Seat
from panoloc.service.pool.worker_process import WorkerProcess
from panoloc.service.settings import Settings
from panoloc.service.worker.plan import WorkerPlan

# The rest is for the service, Redis and a registration. A worker beyond its share is replaced before the system ends something else.
_WORKERS_SHARE = 0.8


def local_pool(settings: Settings, plan: WorkerPlan) -> ProcessPool:
    """Return the pool of this machine; nothing starts yet."""
    gpus = visible_gpus()
    num_workers = settings.num_workers or len(gpus) or num_sockets()
    shared = replace(plan.settings, workers_per_machine=num_workers)
    hello = Hello(replace(plan, settings=shared), (settings.log_level, settings.log_format))
    seats = [_seat(hello, gpus[number % len(gpus)] if gpus else None) for number in range(num_workers)]
    memory_bytes = int(_WORKERS_SHARE * usable_memory_bytes() / num_workers)
    return ProcessPool(hello, seats, settings.queue_limit, settings.num_registrations, memory_bytes)


def _seat(hello: Hello, gpu: str | None) -> Seat:
    variables = {} if gpu is None else {"CUDA_VISIBLE_DEVICES": gpu}
    return lambda on_change, on_loss: WorkerProcess("panoloc.service.pool.child", hello, on_change, on_loss, variables)
