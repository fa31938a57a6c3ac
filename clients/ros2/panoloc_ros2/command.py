"""The command `panoloc ros2`, added to `panoloc` by the entry point of pyproject.toml."""

import inspect
import logging
from typing import Annotated, Any

import typer

from .parameters import Parameters, explained

_HELP = """Give a robot its first pose and corrections while it drives, over DDS, without an installation of ROS.

Reads images, camera_info, /tf and /tf_static of ROS 2 and publishes map → odom on /tf, /panoloc/pose and /initialpose.
ROS_DOMAIN_ID chooses the domain, CYCLONEDDS_URI the network, and PANOLOC_API_KEY holds the key of the service.
docs/ros2.md explains all. Needs `pip install "panoloc\\[ros2]"`."""


_VARIABLES = {"url": "PANOLOC_URL"}


def ros2(**given: Any) -> None:
    """Run the node until Ctrl-C."""
    try:
        from .dds import DdsNode
    except ImportError as error:
        raise typer.BadParameter(
            f'expected cyclonedds, but {error}; install it: pip install "panoloc[ros2]", in a clone pip install -e ".[ros2]"',
            param_hint="ros2",
        ) from error
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s")
    try:
        node = DdsNode(Parameters(**given))
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    node.run()


def add_to(program: typer.Typer) -> None:
    """Add the command: an option for each parameter of the node."""
    signature = [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=default,
            annotation=Annotated[
                type(default), typer.Option(help=meaning.replace("`", ""), envvar=_VARIABLES.get(name))
            ],
        )
        for name, default, meaning in explained()
    ]
    vars(ros2)["__signature__"] = inspect.Signature(signature)
    ros2.__annotations__ = {each.name: each.annotation for each in signature}
    program.command("ros2", help=_HELP)(ros2)
