"""`python -m benchmarks core`: where the time goes, on this machine."""

from __future__ import annotations

# isort: off
import shared.single_thread  # noqa: F401

# isort: on
from benchmarks import core
from shared.cli import EXIT_STANDING, Parser, run


def main() -> int:
    parser = Parser(prog="benchmarks", description=__doc__)
    parser.add_argument("name", choices=["core"])
    parser.add_argument("--repetitions", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    if arguments.repetitions < 1:
        parser.error(f"--repetitions: expected at least 1, got {arguments.repetitions}")
    print(core.run(repetitions=arguments.repetitions, seed=arguments.seed))
    return EXIT_STANDING


if __name__ == "__main__":
    run(main)
