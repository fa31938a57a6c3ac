"""The front doors that use the same workers of a cluster which they joined: who brings these up, and who takes them away.

Each introduces itself in the cluster's list of jobs, which is right whatever ends a process: Ray strikes it off when its connection
breaks. Workers belong to a data folder and a configuration, so that front doors with another one, as after an upgrade, bring up
workers of their own beside those of the others.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from service.host.service_version import service_version
from service.worker.plan import WorkerPlan

_NAME, _CONFIGURATION = "panoloc_workers", "panoloc_configuration"
# What each says of itself while it lives, under its number: that it leaves, or how many queries it has under way.
_WORDS = b"panoloc:front-door:"
_LEAVING = b"leaving"


@dataclass(frozen=True)
class FrontDoor:
    """One of those on the cluster. number: in the order in which they joined. application: name of its workers in Ray Serve."""

    number: int
    application: str
    configuration: Mapping[str, Any]
    where: str


class FrontDoors:
    """Those of one data folder, seen by one of them. Needs a connection to Ray, save for the names."""

    def __init__(self, plan: WorkerPlan, num_workers: int | None) -> None:
        """num_workers: that the operator has asked for, None for what the cluster has."""
        self.configuration = _described(plan, num_workers)
        self._folder = f"panoloc-{_digest(plan.settings.storage_url)}"
        # With what is told to nobody, and may be what differs.
        # Where copies of files lie on a machine is for each to say: any of them serves all.
        bucket = plan.settings.bucket
        variables = None if bucket is None else dict(bucket.variables)
        told_and_untold = [self.configuration, plan.settings.redis_url, variables]
        self.application = f"{self._folder}-{_digest(json.dumps(told_and_untold))}"

    @property
    def introduction(self) -> dict[str, str]:
        """Return what this one says of itself in the list of jobs."""
        return {_NAME: self.application, _CONFIGURATION: json.dumps(self.configuration)}

    def others(self) -> list[FrontDoor]:
        """Return the others on this data folder that live and do not leave, those that joined first at the front."""
        leaving = _leaving()
        found = [_front_door(job) for job in _jobs() if not job.is_dead and _NAME in job.config.metadata]
        own = _own_number()
        return sorted(
            (
                each
                for each in found
                if each.number not in {own, *leaving} and each.application.startswith(f"{self._folder}-")
            ),
            key=lambda each: each.number,
        )

    def senior(self) -> FrontDoor | None:
        """Return the one that brings up the workers which this one uses as well, None when this one does."""
        return next(
            (each for each in self.others() if each.application == self.application and each.number < _own_number()),
            None,
        )

    def are_alone(self) -> bool:
        """Tell whether nobody else uses our workers."""
        return all(each.application != self.application for each in self.others())

    def differing(self) -> list[str]:
        """Return what others on this data folder are set to that we are not, one sentence for each of them."""
        return [
            f"{each.where}: {_difference(each.configuration, self.configuration)}"
            for each in self.others()
            if each.application != self.application
        ]

    def abandoned(self, applications: list[str]) -> list[str]:
        """Return those of the names in Ray Serve that are of this data folder and that no front door uses, not this one either."""
        used = {self.application, *(each.application for each in self.others())}
        return [name for name in applications if name.startswith(f"{self._folder}-") and name not in used]

    def exchange_load(self, num_admitted: int) -> list[int]:
        """Tell how many queries wait or run here, and return how many do at each of the others that use our workers."""
        _say(_own_number(), str(num_admitted).encode())
        said = _words()
        using = [each.number for each in self.others() if each.application == self.application]
        return [int(said[number]) for number in using if number in said]

    def say_leaving(self) -> None:
        """Let those who look from now on not count this one: of several that leave at once, the last one sees no other."""
        _forget(_words().keys() - {_number(job) for job in _jobs() if not job.is_dead})
        _say(_own_number(), _LEAVING)


def _described(plan: WorkerPlan, num_workers: int | None) -> dict[str, Any]:
    settings = asdict(plan.settings)
    settings["redis_url"] = plan.settings.redis_url.rpartition("@")[2]
    # Secrets are in it.
    del settings["bucket"]
    # Of the cluster, which may change.
    del settings["workers_per_machine"]
    return {
        "version": service_version(),
        "num_workers": num_workers,
        "worker": plan.worker,
        "registrar": plan.registrar,
        **settings,
    }


def _difference(theirs: Mapping[str, Any], ours: Mapping[str, Any]) -> str:
    names = sorted(name for name in {*theirs, *ours} if theirs.get(name) != ours.get(name))
    said = [f"{name} {theirs.get(name)} instead of {ours.get(name)}" for name in names]
    return ", ".join(said) or "other passwords or keys of Redis or the storage"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def _jobs() -> list[Any]:
    """Return Ray's own records of its jobs; its public list needs the dashboard."""
    from ray._private.state import state
    from ray.core.generated.gcs_pb2 import JobTableData

    accessor = state._connect_and_get_accessor()
    table = accessor.get_job_table(skip_submission_job_info_field=True, skip_is_running_tasks_field=True)
    return [JobTableData.FromString(entry) for entry in table]


def _front_door(job: Any) -> FrontDoor:
    metadata = job.config.metadata
    where = f"process {job.driver_pid} on {job.driver_address.ip_address}"
    return FrontDoor(_number(job), metadata[_NAME], json.loads(metadata.get(_CONFIGURATION, "{}")), where)


def _number(job: Any) -> int:
    # Ray counts jobs up, and writes the numbers with the lowest byte first.
    return int.from_bytes(job.job_id, "little")


def _own_number() -> int:
    import ray

    return int.from_bytes(bytes.fromhex(ray.get_runtime_context().get_job_id()), "little")


def _leaving() -> set[int]:
    return {number for number, word in _words().items() if word == _LEAVING}


def _words() -> dict[int, bytes]:
    """Return what front doors said of themselves, also those that are gone."""
    from ray.experimental.internal_kv import _internal_kv_get, _internal_kv_list

    said = {int(key.removeprefix(_WORDS)): _internal_kv_get(key) for key in _internal_kv_list(_WORDS)}
    return {number: word for number, word in said.items() if word is not None}


def _say(number: int, word: bytes) -> None:
    from ray.experimental.internal_kv import _internal_kv_put

    _internal_kv_put(_WORDS + str(number).encode(), word)


def _forget(numbers: Iterable[int]) -> None:
    from ray.experimental.internal_kv import _internal_kv_del

    for number in numbers:
        _internal_kv_del(_WORDS + str(number).encode())
