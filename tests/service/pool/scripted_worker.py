"""A worker that does what the image's bytes say, so that pools are tested without the algorithm's seconds."""

import json
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

from panoloc.service.jobs import LocalizeJob, LocalizeOutcome, MapRef, RegisterJob, RegisterOutcome
from panoloc.service.worker.plan import WorkerFailure, WorkerPlan, WorkerReply
from tests.service.made_up_answers import empty_answer


class ScriptedWorker:
    """Indexes are empty files in the folder that `storage_url` names."""

    def __init__(self, settings: WorkerPlan) -> None:
        self._folder = Path(settings.storage_url)
        self._name = f"scripted-{os.getpid()}"
        if (self._folder / "no-worker-starts").exists():
            raise RuntimeError("no worker starts in this folder")

    def localize(
        self, job: LocalizeJob, is_cancelled: Callable[[], bool] = lambda: False
    ) -> WorkerReply[LocalizeOutcome]:
        script = json.loads(job.images[0].data)
        self._note("started", job.request_id)
        missing = tuple(ref for ref in job.maps if script.get("needs_index") and not self._index(ref).exists())
        if missing:
            return WorkerReply(missing=missing, worker=self._name)
        if script.get("crash") or (script.get("crash_once") and self._note("crashed", job.request_id)):
            os.kill(os.getpid(), signal.SIGKILL)
        if "take_mb" in script:
            self._taken = b"x" * (script["take_mb"] << 20)
        self._wait(script, is_cancelled)
        if "fail" in script:
            return WorkerReply(failure=WorkerFailure(script["fail"], "as the script says"), worker=self._name)
        if job.share is not None:
            (self._folder / f"{job.share}.maps").write_text(" ".join(ref.id for ref in job.maps))
            scores = script["scores"] if job.along_walls == script.get("along_walls", False) else {}
            return WorkerReply(scores=tuple(scores.get(ref.id, 0.0) for ref in job.maps), worker=self._name)
        figures = {"pid": os.getpid(), "request_id": job.request_id, "gpus": os.environ.get("CUDA_VISIBLE_DEVICES")}
        figures |= {"maps": [ref.id for ref in job.maps], "num_maps": job.num_maps}
        outcome = LocalizeOutcome(empty_answer(status="localized", search=figures, map_id=script.get("found")))
        view = json.dumps(script["view"]).encode() if "view" in script else b""
        return WorkerReply(outcome, view=view, worker=self._name, duration_s=0.1, resident_bytes=1234)

    def register(self, job: RegisterJob) -> WorkerReply[RegisterOutcome]:
        script = json.loads(job.scan_name)
        self._note(f"registering-{os.getpid()}", job.map.id)
        if script.get("crash"):
            os.kill(os.getpid(), signal.SIGKILL)
        self._wait(script)
        self._index(job.map).touch()
        stats = {"pid": os.getpid(), "nice": os.nice(0)}
        return WorkerReply(RegisterOutcome(stats, [], b""), worker=self._name)

    def rebuild(self, map_ref: MapRef) -> WorkerReply[None]:
        self._note("rebuilt", f"{map_ref.id}-{time.time_ns()}")
        if map_ref.id.startswith("map_broken"):
            return WorkerReply(
                failure=WorkerFailure("StoredFileDamagedError", "its scan is damaged"), worker=self._name
            )
        if not self._note("rebuild-crashed", map_ref.id) or map_ref.id != "map_crash_once":
            time.sleep(0.2)
            self._index(map_ref).touch()
            return WorkerReply(worker=self._name)
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError

    def _wait(self, script: dict[str, str], is_cancelled: Callable[[], bool] = lambda: False) -> None:
        while "until" in script and not (self._folder / script["until"]).exists():
            if script.get("stops") and is_cancelled():
                return
            time.sleep(0.01)

    def _index(self, ref: MapRef) -> Path:
        return self._folder / f"{ref.id}.{ref.revision}.index"

    def _note(self, what: str, name: str) -> bool:
        """Leave a file behind that survives this process; return whether it is new."""
        file = self._folder / f"{name}.{what}"
        is_new = not file.exists()
        file.touch()
        return is_new
