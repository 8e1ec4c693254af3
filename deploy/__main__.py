"""Start, watch and end the stack on this machine."""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

from shared.process.cli import Subcommand, run, run_command

_CONTROL = "deploy.background.control"
_OPERATE = "deploy.operate"
COMMANDS = (
    Subcommand("up", "start the stack and wait for its end", "deploy.up"),
    Subcommand("ps", "show the stacks in the background, or how the last one ended", _CONTROL),
    Subcommand("logs", "print the output of the services", _CONTROL),
    Subcommand("restart", "end one service and start it again", _CONTROL),
    Subcommand("down", "end every stack in the background", _CONTROL),
    Subcommand("push", "push the robot of a running stack", _OPERATE),
    Subcommand("link", "change the link of a running stack", _OPERATE),
    Subcommand("go", "let the robot of a running stack walk to a place", _OPERATE),
    Subcommand("drive", "drive the robot of a running stack, by keys or a gamepad", _OPERATE),
    Subcommand("controller", "change the controller of a running stack", _OPERATE),
    Subcommand("pause", "let simulated time of a running stack stand still", _OPERATE),
    Subcommand("step", "let simulated time go on for some ticks", _OPERATE),
    Subcommand("speed", "slow simulated time down", _OPERATE),
    Subcommand("resume", "let simulated time go on", _OPERATE),
    Subcommand("reset", "put the robot of a running stack on its feet", _OPERATE),
    Subcommand("keys", "make certificates for connections between machines", "deploy.keys"),
)


def main() -> int:
    return run_command(__doc__, COMMANDS)


if __name__ == "__main__":
    run(main)
