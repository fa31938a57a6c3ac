"""A Ray cluster on which the scripted workers of a plan run, as `panoloc workers` would bring them up."""

import pickle
import subprocess
import sys

from panoloc.service.worker.plan import WorkerPlan
from tests.integration.running_service import ROOT

_DEPLOY = "import pickle, sys; from panoloc.service.ray.application import deploy"
_DEPLOY += "; deploy(sys.argv[1], pickle.loads(bytes.fromhex(sys.argv[2])))"


def deploy(address: str, plan: WorkerPlan) -> None:
    """Bring the workers of a plan up on a cluster, in a process of its own, and return once they are up."""
    command = [sys.executable, "-c", _DEPLOY, address, pickle.dumps(plan).hex()]
    subprocess.run(command, cwd=ROOT, check=True, timeout=240)
