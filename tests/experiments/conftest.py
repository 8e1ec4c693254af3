from __future__ import annotations

import pytest

from experiments.studies.study_file import read_study


@pytest.fixture
def study_of(tmp_path):
    """A study from TOML text."""

    def build(text, **options):
        path = tmp_path / "short.toml"
        path.write_text(text)
        return read_study(path, **options)

    return build
