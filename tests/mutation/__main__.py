"""Measure how many small faults the quick tests notice: `scripts/mutation --sample 320 --seed 1`.

docs/mutation.md says what is mutated, how to read the figures, and why the mutants that live may live.
"""

import argparse
import random
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from fnmatch import fnmatch
from pathlib import Path

from tests.mutation.mutants import MutableFile, Mutant
from tests.mutation.runner import Child, Ended, Status, ended, load_libraries, start
from tests.mutation.targets import ROOT, Target, targets

_POLL_S = 0.02
# A mutant may take this many times as long as its tests without it, and some seconds; then it runs for ever.
_PATIENCE, _LEAST_S = 5.0, 20.0
_BASELINE_LIMIT_S = 600.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Return 0 when the score reaches `--at-least`, else 1."""
    options = _parsed(arguments)
    chosen = [target for target in targets() if fnmatch(target.file, options.only)]
    sample = list(_sampled(chosen, options))
    by_file = {target.file: target for target in chosen}
    if options.list:
        print("\n".join(map(str, sample)))
        return 0
    load_libraries()
    began = time.monotonic()
    limits = _limits(
        [target for target in chosen if any(mutant.file == target.file for mutant in sample)], options.jobs
    )
    found: dict[str, Status] = {}
    for mutant, end in _all_run(sample, by_file, limits, options.jobs):
        found[mutant.name] = end.status
        print(f"[{len(found)}/{len(sample)}] {end.seconds:5.1f} s  {end.status:9}  {mutant}", flush=True)
        if options.verbose:
            print(end.printed)
    return _reported(sample, found, time.monotonic() - began, options)


def _parsed(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="scripts/mutation", description=__doc__)
    parser.add_argument("--sample", type=int, default=320, help="how many mutants (default: 320)")
    parser.add_argument("--seed", type=int, default=1, help="of the choice (default: 1)")
    parser.add_argument("--only", default="*", help="pattern of files, such as 'core/judge/*'")
    parser.add_argument("--name", action="append", help="run these mutants instead of a sample; as they are printed")
    parser.add_argument("--jobs", type=int, default=2, help="mutants at the same time (default: 2)")
    parser.add_argument("--at-least", type=float, default=0.0, help="score below which to exit with 1")
    parser.add_argument("--survivors", type=Path, help="write those that live to this file")
    parser.add_argument("--list", action="store_true", help="only show which mutants there are")
    parser.add_argument("--verbose", action="store_true", help="show what the tests print")
    return parser.parse_args(arguments)


def _sampled(chosen: Sequence[Target], options: argparse.Namespace) -> Iterator[Mutant]:
    """Yield the sample in the order of the files; every mutant of every file is as likely as any other."""
    files = [MutableFile(target.file, (ROOT / target.file).read_text(encoding="utf-8")) for target in chosen]
    every = [(k, number) for k, file in enumerate(files) for number in range(len(file))]
    print(f"{len(every)} mutants of {len(files)} files", file=sys.stderr)
    if options.name:
        yield from (found for name in options.name for file in files if (found := file.named(name)) is not None)
        return
    random.Random(options.seed).shuffle(every)
    sample: dict[tuple[int, int], Mutant] = {}
    seen: set[str] = set()
    for k, number in every:
        mutant = files[k].mutant(number)
        if len(sample) < options.sample and mutant is not None and mutant.source not in seen:
            sample[k, number] = mutant
            seen.add(mutant.source)
        if len(sample) == options.sample:
            break
    yield from (sample[place] for place in sorted(sample))


def _limits(chosen: Sequence[Target], jobs: int) -> dict[str, float]:
    """Return the seconds that a mutant of each file may take. Raises RuntimeError when its tests fail without one."""
    limits: dict[tuple[str, ...], float] = {}
    waiting = list(dict.fromkeys(target.tests for target in chosen))
    running: list[tuple[tuple[str, ...], Child]] = []
    while waiting or running:
        while waiting and len(running) < jobs:
            tests = waiting.pop()
            running.append((tests, start(tests, None, _BASELINE_LIMIT_S)))
        for tests, child in list(running):
            if (end := ended(child)) is None:
                continue
            running.remove((tests, child))
            if end.status != "lives":
                raise RuntimeError(f"{' '.join(tests)}: expected to pass on the code as it is\n{end.printed[-4000:]}")
            print(f"{end.seconds:5.1f} s without a mutant: {' '.join(tests)}", flush=True)
            limits[tests] = _LEAST_S + _PATIENCE * end.seconds
        time.sleep(_POLL_S)
    return {target.file: limits[target.tests] for target in chosen}


def _all_run(
    sample: Sequence[Mutant], by_file: dict[str, Target], limits: dict[str, float], jobs: int
) -> Iterator[tuple[Mutant, Ended]]:
    waiting = list(reversed(sample))
    running: list[tuple[Mutant, Child]] = []
    while waiting or running:
        while waiting and len(running) < jobs:
            mutant = waiting.pop()
            running.append((mutant, start(by_file[mutant.file].tests, mutant, limits[mutant.file])))
        for mutant, child in list(running):
            if (end := ended(child)) is not None:
                running.remove((mutant, child))
                yield mutant, end
        time.sleep(_POLL_S)


def _reported(sample: Sequence[Mutant], found: dict[str, Status], seconds: float, options: argparse.Namespace) -> int:
    living = [mutant for mutant in sample if found[mutant.name] == "lives"]
    print(f"\n{len(living)} of {len(sample)} live:")
    for mutant in living:
        print(f"  {mutant}")
    print()
    total, lost = Counter(mutant.file for mutant in sample), Counter(mutant.file for mutant in living)
    for file in sorted(total):
        print(f"  {total[file] - lost[file]:4} of {total[file]:4} noticed in {file}")
    score = 1 - len(living) / max(1, len(sample))
    timed_out = sum(status == "timed out" for status in found.values())
    print(
        f"\nscore {score:.3f}: {len(sample) - len(living)} of {len(sample)} noticed, {timed_out} of these by running out of time;"
        f" seed {options.seed}, {seconds / 60:.1f} minutes"
    )
    if options.survivors:
        options.survivors.write_text("".join(f"{mutant}\n" for mutant in living))
    return int(score < options.at_least)


if __name__ == "__main__":
    sys.exit(main())
