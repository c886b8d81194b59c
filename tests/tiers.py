"""Which tests run always, and which only with `--everything`.

A test is quick unless it has one of the marks below, by a decorator or by these tables. The quick ones cover every room: a law of
each kind in both forms and precisions, files, a map, a picture, a command, the simulator, the reference.
"""

MARKS = ("slow", "sim", "evaluation")
"""What is left out unless it is asked for. All are registered in pyproject.toml."""

QUICK_AMONG_SLOW: dict[str, tuple[str, ...]] = {}
"""Files whose tests are slow, sim or evaluation but for these."""


def mark(items) -> None:
    """Gives every collected test the marks of its file."""
    for item in items:
        name = item.path.name
        if name in QUICK_AMONG_SLOW and item.originalname not in QUICK_AMONG_SLOW[name]:
            item.add_marker(kind(name))


def kind(file: str) -> str:
    """The mark of the slow tests of a file."""
    return "sim" if file.startswith("test_tsid") else "evaluation" if file.startswith("test_evaluation") else "slow"


def is_quick(item) -> bool:
    """Whether a test runs always."""
    return not any(item.get_closest_marker(name) for name in MARKS)
