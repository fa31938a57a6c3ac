"""The commands of the lab, added to `panoloc` by the entry point of pyproject.toml."""

import typer

from panoloc.lab.commands import bench, demo, evaluate


def add_to(program: typer.Typer) -> None:
    """Add the commands of the lab to `panoloc`."""
    program.command()(demo.demo)
    program.command()(bench.bench)
    program.add_typer(evaluate.app, name="evaluate")
