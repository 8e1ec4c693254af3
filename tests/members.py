"""Other members of a library's module, for one module that uses it."""

from __future__ import annotations

from types import ModuleType, SimpleNamespace
from typing import Any

import pytest


def replace_members(
    monkeypatch: pytest.MonkeyPatch, module: ModuleType, name: str, **members: Any
) -> None:
    """Give `module` other members of the library that it imports as `name`.

    The library itself stays as it is: other threads of the test's process use it meanwhile.
    """
    monkeypatch.setattr(module, name, SimpleNamespace(**vars(getattr(module, name)) | members))
