"""`python -m tests.campaign`: hostile files and requests, kills, overload and soak, on loopback only; prints one table.

Bounded by its options; docs/reliability.md says what it measures and what was found.
"""

import argparse
import sys
from collections.abc import Callable
from functools import partial

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
        "node: of a Ray cluster, killed during 200 queries; campus: one of three, during 50 queries over 300 maps;\n"
        "overload: clients that ask again at once; crowd: new clients at ten times the rate of answers;\n"
        "intake: reads 40 scans with mixed-up units, axes, coordinate systems and heights;\n"
        "robot: drives through a flat with odometry that errs (docs/ros2.md);\n"
        "phones: 20 that look for their place, in a browser; walks: a minute each with the npm package's tracker;\n"
        "changes: objects that came, went or moved in rooms; all",
    )
    parser.add_argument(
        "--cases", type=int, default=10_000, help="damaged scans; half as many images and requests (10,000)"
    )
    parser.add_argument("--kills", type=int, default=20, help="of each class of processes (20)")
    parser.add_argument("--overload-s", type=float, default=300.0, help="seconds of overload, and of crowd (300)")
    parser.add_argument("--soak-s", type=float, default=3600.0, help="seconds of soak (3600)")
    parser.add_argument("--phones", type=int, default=20, help="phones that look for their place (20)")
    parser.add_argument("--intake-scans", type=int, default=40, help="of intake (40)")
    parser.add_argument("--rooms", type=int, default=30, help="rooms whose furniture changed (30)")
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
    # Torch takes seconds to import, for which `--help` need not wait.
    from tests.campaign.changes import changes
    from tests.campaign.hostile_files import hostile_images, hostile_scans
    from tests.campaign.hostile_requests import hostile_requests
    from tests.campaign.intake import intake
    from tests.campaign.kills import node_killed, node_of_campus_killed, process_kills, replica_kills, service_kills
    from tests.campaign.overload import impatient, newcomers
    from tests.campaign.phones import phones
    from tests.campaign.robot import robot
    from tests.campaign.running import soak
    from tests.campaign.walks import walks

    return {
        "scans": partial(hostile_scans, given.cases, given.seed),
        "images": partial(hostile_images, given.cases // 2, given.seed),
        "requests": partial(hostile_requests, given.cases // 2, given.seed),
        "worker": partial(process_kills, "worker", given.kills),
        "redis": partial(process_kills, "redis", given.kills),
        "replica": partial(replica_kills, given.kills),
        "service": partial(service_kills, given.kills),
        "node": node_killed,
        "campus": node_of_campus_killed,
        "overload": partial(impatient, given.overload_s),
        "crowd": partial(newcomers, given.overload_s),
        "intake": partial(intake, given.intake_scans, given.seed),
        "robot": partial(robot, 0),
        "phones": partial(phones, given.phones, given.seed),
        "walks": partial(walks, given.seed),
        "changes": partial(changes, given.rooms),
        "soak": partial(soak, given.soak_s),
    }


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
