"""`python -m tests.campaign`: hostile files and requests, kills, overload and soak, on loopback only; prints one table.

Bounded by its options; docs/reliability.md says what it measures and what was found.
"""

import argparse
import sys
from collections.abc import Callable

from panoloc.service.host.logging import configure_logging
from tests.campaign.outcome import Outcome, table


def main(arguments: list[str]) -> int:
    """Run the parts that are asked for, and return 1 where a promise was broken."""
    parser = argparse.ArgumentParser(
        prog="scripts/campaign", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument(
        "parts",
        nargs="*",
        help="scans, images, requests; kills of: worker, redis, replica (of the API, behind a proxy), service; soak;\n"
        "node: of a Ray cluster, killed during 200 queries;\n"
        "overload: clients that ask again at once; crowd: new clients at ten times the rate of answers; all",
    )
    parser.add_argument(
        "--cases", type=int, default=10_000, help="damaged scans; half as many images and requests (10,000)"
    )
    parser.add_argument("--kills", type=int, default=20, help="of each class of processes (20)")
    parser.add_argument("--overload-s", type=float, default=300.0, help="seconds of overload, and of crowd (300)")
    parser.add_argument("--soak-s", type=float, default=3600.0, help="seconds of soak (3600)")
    parser.add_argument("--seed", type=int, default=1, help="the same seed damages in the same way (1)")
    given = parser.parse_args(arguments)
    parts = _parts(given)
    unknown = set(given.parts) - set(parts)
    if unknown:
        parser.error(f"expected parts among {', '.join(parts)}, got {', '.join(sorted(unknown))}")
    configure_logging("critical", "console")
    outcomes = []
    for name in given.parts or parts:
        outcomes.append(parts[name]())
        print(table(outcomes[-1:]), file=sys.stderr, flush=True)
    print(table(outcomes))
    return int(any(outcome.faults for outcome in outcomes))


def _parts(given: argparse.Namespace) -> dict[str, Callable[[], Outcome]]:
    # Imported by those who run them: torch takes seconds.
    def scans() -> Outcome:
        from tests.campaign.hostile_files import hostile_scans

        return hostile_scans(given.cases, given.seed)

    def images() -> Outcome:
        from tests.campaign.hostile_files import hostile_images

        return hostile_images(given.cases // 2, given.seed)

    def requests() -> Outcome:
        from tests.campaign.hostile_requests import hostile_requests

        return hostile_requests(given.cases // 2, given.seed)

    def killed(process: str) -> Callable[[], Outcome]:
        def run() -> Outcome:
            from tests.campaign.running import kills

            return kills(process, given.kills)

        return run

    def replica() -> Outcome:
        from tests.campaign.api_replicas import replica_kills

        return replica_kills(given.kills)

    def service() -> Outcome:
        from tests.campaign.api_replicas import service_kills

        return service_kills(given.kills)

    def node() -> Outcome:
        from tests.campaign.cluster_nodes import node_killed

        return node_killed()

    def overloaded() -> Outcome:
        from tests.campaign.overload import impatient

        return impatient(given.overload_s)

    def crowded() -> Outcome:
        from tests.campaign.overload import newcomers

        return newcomers(given.overload_s)

    def soaked() -> Outcome:
        from tests.campaign.running import soak

        return soak(given.soak_s)

    of_processes = {name: killed(name) for name in ("worker", "redis")}
    return {
        "scans": scans,
        "images": images,
        "requests": requests,
        **of_processes,
        "replica": replica,
        "service": service,
        "node": node,
        "overload": overloaded,
        "crowd": crowded,
        "soak": soaked,
    }


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
