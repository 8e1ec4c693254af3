"""First pages of a manual: each file is one thing to do, to run and to change."""

import shared.process.native_libraries  # noqa: F401
