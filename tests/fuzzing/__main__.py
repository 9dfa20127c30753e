"""Throw damaged bytes at everything that reads what strangers send, in this process.

    PYTHONPATH=tests python -m fuzzing --messages 1000000            some minutes
    PYTHONPATH=tests python -m fuzzing --seed 1234 --messages 1      one of them again

Whatever is not accepted or refused with a documented error ends the run with its seed.
"""

import argparse
import random
import sys

from fuzzing.targets import TARGETS, damaged, seeds


def main() -> None:
    """Read the command line and run."""
    parser = argparse.ArgumentParser(prog="python -m fuzzing", description=__doc__.splitlines()[0])
    parser.add_argument("--messages", type=int, default=50_000)
    parser.add_argument("--seed", type=int, default=0, help="of the first; the others count up")
    options = parser.parse_args()
    good, names = seeds(), list(TARGETS)
    for seed in range(options.seed, options.seed + options.messages):
        name, rng = names[seed % len(names)], random.Random(seed)
        try:
            TARGETS[name](damaged(name, good[name], rng))
        except Exception as error:
            sys.exit(f"{name}: {type(error).__name__}: {error}\nagain with --seed {seed}")
    print(f"{options.messages} damaged inputs, each accepted or refused as documented")


if __name__ == "__main__":
    main()
