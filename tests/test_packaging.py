"""The conda recipe needs what the package needs."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_the_recipe_has_the_version_and_the_dependencies_of_the_package():
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    project = pyproject["project"]
    recipe = (ROOT / "packaging" / "recipe.yaml").read_text("utf-8")
    assert f"version: {project['version']}" in recipe
    python = f"python{project['requires-python']}"
    assert _listed(recipe, "host") == {python, "pip", *pyproject["build-system"]["requires"]}
    needed = {n.replace("matplotlib>", "matplotlib-base>") for n in project["dependencies"]}
    assert _listed(recipe, "run") == {python, *needed}


def _listed(recipe, section):
    found = re.search(rf"  {section}:\n((?:    - .*\n)+)", recipe)
    assert found is not None
    return {line.strip("- ").replace(" ", "") for line in found[1].splitlines()}
