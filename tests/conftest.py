"""Rules that hold for every test."""

import os

import pytest
from hypothesis import settings

# What the person who runs the tests has set for commands of their own is not part of them.
for _name in [name for name in os.environ if name.startswith("PICA_")]:
    del os.environ[_name]
os.environ["PICA_CONFIG"] = os.devnull

MARKS = {"unit", "call", "render", "train", "realtime", "gpu"}

# The same examples in every run: a red build is red for the next person, too.
settings.register_profile("repeatable", derandomize=True, deadline=None, print_blob=True)
settings.register_profile("quick", settings.get_profile("repeatable"), max_examples=15)
settings.register_profile("fuzz", deadline=None, max_examples=100_000)
settings.load_profile("repeatable")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Golden files are renewed on purpose only; look at the difference before committing it."""
    parser.addoption(
        "--regenerate-golden",
        action="store_true",
        help="write golden images anew instead of comparing with them",
    )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Refuse to run modules that do not say, with one mark, what they need."""
    modules = {item.getparent(pytest.Module) for item in items}
    unmarked = sorted(
        module.nodeid
        for module in modules
        if module is not None and len(_declared_marks(module.obj)) != 1
    )
    if unmarked:
        marks = ", ".join(sorted(MARKS))
        raise pytest.UsageError(
            f"each test module declares one pytestmark of {marks}: {', '.join(unmarked)}"
        )


def _declared_marks(module: object) -> set[str]:
    marks = getattr(module, "pytestmark", [])
    return {mark.name for mark in (marks if isinstance(marks, list) else [marks])} & MARKS
