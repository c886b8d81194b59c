"""The subcommands of `jaxcap`, by name. Importing this module needs tyro and tqdm (extra `cli`)."""

from collections.abc import Callable, Sequence

import tyro

from jaxcap.commands.map import MAP, map_kernel
from jaxcap.commands.next import NEXT, next_contact
from jaxcap.commands.plot import PLOT, plot
from jaxcap.commands.score import score
from jaxcap.commands.score_help import SCORE
from jaxcap.commands.states import STATES, states
from jaxcap.commands.view import VIEW, view

COMMANDS: dict[str, tuple[Callable[..., None], str]] = {
    "states": (states, STATES),
    "score": (score, SCORE),
    "view": (view, VIEW),
    "map": (map_kernel, MAP),
    "next": (next_contact, NEXT),
    "plot": (plot, PLOT),
}
"""The function, and the text of its help."""


def run(arguments: Sequence[str]) -> None:
    """Parses the arguments and runs the subcommand. Raises SystemExit after --help and for wrong usage."""
    app = tyro.extras.SubcommandApp()
    for name, (command, text) in COMMANDS.items():
        chosen = name in arguments[:1]  # the list of commands gives each one line
        app.command(name=name, help=text if chosen else text.partition("\n")[0])(command)
    app.cli(
        prog="jaxcap",
        description="Can this robot still stop? Zero-step capturability in multi-contact.\n\n"
        "jaxcap --version prints the version.",
        args=arguments,
        config=(tyro.conf.FlagCreatePairsOff,),
    )
