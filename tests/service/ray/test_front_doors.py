"""Who of several front doors on one cluster brings up the workers, and who takes them away. No real Ray."""

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from service.ray import front_doors as module
from service.ray.front_doors import FrontDoors
from service.settings import Settings
from service.storage import BucketAccess
from service.worker.plan import WorkerPlan, WorkerSettings

FOLDER = Path("/data/maps")


@dataclass
class Cluster:
    """The jobs of a cluster, in place of Ray's: `join` adds one, `own` is the number of the one that looks."""

    jobs: list[Any] = field(default_factory=list)
    words: dict[int, bytes] = field(default_factory=dict)
    own: int = 0

    def join(self, door: FrontDoors | None) -> int:
        number = len(self.jobs) + 1
        metadata = {} if door is None else door.introduction
        self.jobs.append(
            SimpleNamespace(
                job_id=number.to_bytes(4, "little"),
                is_dead=False,
                driver_pid=1000 + number,
                driver_address=SimpleNamespace(ip_address="10.0.0.7"),
                config=SimpleNamespace(metadata=metadata),
            )
        )
        return number


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Cluster:
    cluster = Cluster()
    monkeypatch.setattr(module, "_jobs", lambda: cluster.jobs)
    monkeypatch.setattr(module, "_words", lambda: dict(cluster.words))
    monkeypatch.setattr(module, "_say", lambda number, word: cluster.words.update({number: word}))
    monkeypatch.setattr(module, "_forget", lambda numbers: [cluster.words.pop(number) for number in list(numbers)])
    monkeypatch.setattr(module, "_own_number", lambda: cluster.own)
    return cluster


def door(
    folder: Path = FOLDER, num_workers: int | None = None, redis: str = "redis://cache:6379", **set_to: Any
) -> FrontDoors:
    settings = replace(WorkerSettings.of(Settings(data_dir=folder), redis), **set_to)
    return FrontDoors(WorkerPlan(settings), num_workers)


def test_workers_are_named_by_their_folder_and_their_configuration() -> None:
    assert door().application == door(workers_per_machine=3).application
    others = [
        door(Path("/data/other")),
        door(num_workers=2),
        door(resident_bytes=1),
        door(redis="redis://:other@cache:6379"),
    ]
    assert len({door().application, *(each.application for each in others)}) == 5


def test_passwords_of_redis_and_keys_of_a_bucket_are_told_to_nobody_but_set_workers_apart() -> None:
    bucket = BucketAccess("/tmp/copies", 1, {"AWS_SECRET_ACCESS_KEY": "secret"})
    ours = door(redis="redis://user:secret@cache:6379/0", bucket=bucket)
    assert (
        ours.application
        != door(redis="redis://user:secret@cache:6379/0", bucket=replace(bucket, variables={})).application
    )
    elsewhere = replace(bucket, local_folder="/data/copies", copies_bytes=2)
    assert door(redis="redis://user:secret@cache:6379/0", bucket=elsewhere).application == ours.application
    said = ours.introduction
    assert "cache:6379/0" in said["panoloc_configuration"]
    assert "secret" not in json.dumps(said)


def test_the_one_that_joined_first_brings_the_workers_up_until_it_dies(cluster: Cluster) -> None:
    cluster.join(None)  # somebody else's job
    first, second, third = (cluster.join(door()) for _ in range(3))
    cluster.own = first
    assert door().senior() is None
    for own in (second, third):
        cluster.own = own
        senior = door().senior()
        assert senior is not None
        assert (senior.number, senior.where) == (first, "process 1002 on 10.0.0.7")
    cluster.jobs[first - 1].is_dead = True
    cluster.own = second
    assert door().senior() is None


def test_the_number_of_a_job_is_read_in_ray_s_order(cluster: Cluster) -> None:
    for _ in range(255):
        cluster.join(None)
    cluster.join(door())  # 256: its lowest byte is 0
    cluster.own = cluster.join(door())
    senior = door().senior()
    assert senior is not None
    assert senior.number == 256


def test_of_those_that_leave_at_the_same_time_the_last_one_finds_itself_alone(cluster: Cluster) -> None:
    first, second = cluster.join(door()), cluster.join(door())
    gone = cluster.join(door())
    cluster.jobs[gone - 1].is_dead = True
    cluster.words = {gone: b"3"}
    cluster.own = first
    door().say_leaving()
    assert not door().are_alone()
    assert cluster.words == {first: b"leaving"}
    cluster.own = second
    door().say_leaving()
    assert door().are_alone()
    assert door().senior() is None


def test_others_with_another_configuration_are_told_apart_and_use_other_workers(cluster: Cluster) -> None:
    cluster.join(door(resident_bytes=7, max_points=8))
    cluster.join(door(Path("/data/other"), resident_bytes=9))
    cluster.own = cluster.join(door(resident_bytes=1, max_points=8))
    ours = door(resident_bytes=1, max_points=8)
    assert ours.senior() is None
    assert ours.are_alone()
    assert ours.differing() == ["process 1001 on 10.0.0.7: resident_bytes 7 instead of 1"]


def test_another_password_of_redis_is_said_to_be_one(cluster: Cluster) -> None:
    cluster.join(door(redis="redis://:old@cache:6379"))
    cluster.own = cluster.join(door(redis="redis://:new@cache:6379"))
    assert door(redis="redis://:new@cache:6379").differing() == [
        "process 1001 on 10.0.0.7: other passwords or keys of Redis or the storage"
    ]


def test_workers_of_this_folder_that_nobody_uses_are_abandoned(cluster: Cluster) -> None:
    killed, living, ours = door(num_workers=1), door(num_workers=2), door(num_workers=3)
    of_others = door(Path("/data/other"))
    cluster.jobs[cluster.join(killed) - 1].is_dead = True
    cluster.join(living)
    cluster.own = cluster.join(ours)
    running = [each.application for each in (killed, living, ours, of_others)] + ["somebody-else"]
    assert ours.abandoned(running) == [killed.application]


def test_load_is_told_to_those_who_use_the_same_workers(cluster: Cluster) -> None:
    first, second, other, dead, leaving = (
        cluster.join(each) for each in (door(), door(), door(num_workers=7), door(), door())
    )
    cluster.jobs[dead - 1].is_dead = True
    cluster.words = {other: b"5", dead: b"6", leaving: b"leaving"}
    cluster.own = first
    assert door().exchange_load(2) == []  # the second has not said anything yet
    cluster.own = second
    assert door().exchange_load(4) == [2]
    cluster.own = first
    assert door().exchange_load(0) == [4]
    assert cluster.words[first] == b"0"
