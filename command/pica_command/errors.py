"""What a user of the ``pica`` command can mend: each error is one line that names the remedy."""


class UsageError(Exception):
    """Words, variables or files that say what no command understands."""

    exit_code = 2
