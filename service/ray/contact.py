"""Whether a cluster that we joined still answers, without asking Ray, whose calls hang when it does not."""

import contextlib
import socket
from dataclasses import dataclass
from typing import Any, Self

_ANSWER_S = 2.0


@dataclass(frozen=True)
class Contact:
    """points: what listens where, `(name, host, port)` each."""

    points: tuple[tuple[str, str, int], ...]

    @classmethod
    def of_connection(cls, ray: Any) -> Self:
        """Return the cluster's head, and the node of this machine through which this process reaches all others."""
        here = ray.get_runtime_context()
        host, _, port = here.gcs_address.rpartition(":")
        points = [("head", host.strip("[]"), int(port))]
        points += [
            ("node of this machine", node["NodeManagerAddress"], node["NodeManagerPort"])
            for node in ray.nodes()
            if node["NodeID"] == here.get_node_id()
        ]
        return cls(tuple(points))

    def silent(self) -> str | None:
        """Return what does not answer, None when all is well; takes at most four seconds. May be called in any thread."""
        for name, host, port in self.points:
            try:
                # The kernel accepts for a process that is busy; where there is none, it refuses.
                with contextlib.closing(socket.create_connection((host, port), _ANSWER_S)):
                    continue
            except OSError as error:
                return f"Ray's {name} does not answer at {host}:{port} ({error.strerror or error})"
        return None
