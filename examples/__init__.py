"""Examples of a page each, to run and to change."""

import shared.process.native_libraries  # noqa: F401
