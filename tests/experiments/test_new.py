"""Templates of a controller, task, robot and plant: each passes its own test as it is made."""

from __future__ import annotations

import os
import subprocess

import pytest

from experiments.new import KINDS, make
from shared.config.extensions import TABLES
from shared.errors import ConfigError
from shared.process.entry import python
from shared.toml_file import read_toml

SETTING = {"controller": "controller", "task": "task", "robot": "robot.name", "plant": "plant.kind"}


@pytest.mark.parametrize("kind", KINDS)
def test_the_test_of_a_new_folder_passes(tmp_path, kind):
    folder = tmp_path / "my_own"
    make(kind, "my_own", folder)
    tested = subprocess.run(
        python("-m", "pytest", "-q", "-p", "no:cacheprovider"),
        cwd=folder,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert tested.returncode == 0, tested.stdout + tested.stderr
    assert not [path for path in folder.rglob("*") if "NAME" in path.name]


@pytest.mark.parametrize("kind", KINDS)
def test_its_entry_point_names_what_is_in_it(tmp_path, kind, monkeypatch):
    make(kind, f"their_{kind}", tmp_path / kind)
    monkeypatch.syspath_prepend(tmp_path / kind)
    project = read_toml(tmp_path / kind / "pyproject.toml", what="the template")["project"]
    table = TABLES[SETTING[kind]]
    announced = project["entry-points"][table.group]
    for module in ("shared.extensions", "shared.robots.catalogue"):
        monkeypatch.setattr(f"{module}.announced", lambda group: announced)
    loaded = table.load(f"their_{kind}")
    name = loaded.name if kind == "robot" else loaded.__name__
    assert name in (f"their_{kind}", f"Their{kind.capitalize()}")


@pytest.mark.parametrize("name", ["My", "1st", "a-b", "", "../up"])
def test_a_name_that_no_package_can_have_is_refused(tmp_path, name):
    with pytest.raises(ConfigError, match="expected a name of a-z"):
        make("task", name, tmp_path / "folder")
    assert not (tmp_path / "folder").exists()


def test_an_existing_folder_is_left_alone(tmp_path):
    with pytest.raises(ConfigError, match="exists; try another"):
        make("task", "mine", tmp_path)
    assert not list(tmp_path.iterdir())
