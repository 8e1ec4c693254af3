"""Commands of an operator to a running stack, and the events that they become.

A command is a line of text, in the command line, in messages and in a run's record alike: `push
120N +y --for 0.2s`, `link delay 80ms`, `controller lc`. The values are in `commands`, and
`texts.parse_command` makes a value of a text. An event is a command with the task time of its
effect: `events` has the file of a run's events. `messages` has the messages on the telemetry
session, which never crosses the link under test.
"""
