"""What `panoloc evaluate parameters` does once its options are known, and its table; imports the algorithm."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from rich.markup import escape

from panoloc.lab.commands.evaluation_run import rows_shown, set_threads
from panoloc.lab.display import show_report, table
from panoloc.lab.evaluation.known_cases import ScanCases
from panoloc.lab.evaluation.methods import compared_method
from panoloc.lab.evaluation.parameters import Outcome, Worth, parameters_like, worth_of
from panoloc.lab.evaluation.rows import RowsFile
from panoloc.lab.evaluation.runner import Evaluation, RunOptions
from panoloc.service.cli.session import Session


def run_parameters(
    scans: Sequence[ScanCases], patterns: Sequence[str], device: str | None, out: Path, session: Session
) -> None:
    """Run what is left of all variants, print what each parameter is worth, and write it beside the rows.

    Raises a CoreError for options that are not as expected. A variant that fails for whatever reason is a failure in its row.
    """
    set_threads()
    base = compared_method("fast")
    chosen = parameters_like(base, patterns)
    variants = [method for each in chosen for method in (each.half, each.double) if method is not None]
    options = RunOptions(device, errors=(Exception,))
    rows = rows_shown(Evaluation(scans, [base, *variants], RowsFile(out / "rows.jsonl"), options), session)
    found = worth_of(chosen, base, rows)
    document = [_document(each) for each in found]
    tables = [table([_line(each) for each in found], 2)]
    show_report(session, out, "parameters", document, tables, {"parameters": document})
    session.messages.print(f"In {escape(str(out))}: parameters.txt, parameters.json, rows.jsonl")


def _document(worth: Worth) -> dict[str, object]:
    """Return what a parameter is worth, for JSON."""
    outcomes = {"half": worth.half, "as_it_is": worth.same, "double": worth.double}
    return {
        "parameter": worth.parameter.name,
        "value": worth.parameter.value,
        **{name: None if outcome is None else asdict(outcome) for name, outcome in outcomes.items()},
    }


def _line(worth: Worth) -> dict[str, object]:
    """Return a row of the table: figures with half of a parameter, as it is, and with twice as much."""
    outcomes = (worth.half, worth.same, worth.double)

    def all_three(text: Callable[[Outcome], str]) -> str:
        """Return a figure of the three outcomes side by side."""
        return " ".join("–" if outcome is None else text(outcome) for outcome in outcomes)

    varied = [outcome for outcome in (worth.half, worth.double) if outcome is not None]
    return {
        "parameter": worth.parameter.name,
        "value": worth.parameter.value,
        "right: ½ 1 2": all_three(lambda outcome: str(outcome.right)),
        "localized": all_three(lambda outcome: str(outcome.localized)),
        "wrong": all_three(lambda outcome: str(outcome.wrong)),
        "median error m": all_three(_error),
        "s": all_three(lambda outcome: f"{outcome.seconds:.2f}"),
        "other answers": sum(outcome.others or 0 for outcome in varied),
        "failed": sum(outcome.failed for outcome in varied),
    }


def _error(outcome: Outcome) -> str:
    return "–" if outcome.position_error_m is None else f"{outcome.position_error_m:.4f}"
