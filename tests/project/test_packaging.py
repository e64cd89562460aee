"""What is beside the package for those who pack it: recipe and containers are of the project as it is."""

import importlib.util
import re
import subprocess
import sys
import tomllib

import pytest
import yaml
from fixtures.samples import ROOT

PACKAGING = ROOT / "analysis" / "packaging"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
OF_CONDA = {"matplotlib": "matplotlib-base", "lazy_loader": "lazy-loader"}
"""Names that conda-forge has otherwise, but for capitals."""


def test_the_recipe_needs_what_the_project_needs():
    recipe = yaml.safe_load((PACKAGING / "recipe.yaml").read_text(encoding="utf-8"))
    names = [re.match(r"[\w.-]+", each).group() for each in PROJECT["dependencies"]]
    bounds = [each.removeprefix(name) for each, name in zip(PROJECT["dependencies"], names, strict=True)]
    expected = [
        f"{OF_CONDA.get(name, name.lower())} {bound}" for name, bound in zip(names, bounds, strict=True)
    ]
    assert recipe["requirements"]["run"][1:] == expected
    assert recipe["context"]["python_min"] == PROJECT["requires-python"].removeprefix(">=")
    assert recipe["build"]["noarch"] == "python"
    assert recipe["about"]["license"] == PROJECT["license"]


def test_the_recipe_renders():
    """By rattler-build, where it is installed."""
    if importlib.util.find_spec("rattler_build") is None:
        pytest.skip("py-rattler-build is not installed")
    from rattler_build import PlatformConfig, RenderConfig, Stage0Recipe, VariantConfig

    config = RenderConfig(platform=PlatformConfig(experimental=True))
    (one,) = Stage0Recipe.from_file(PACKAGING / "recipe.yaml").render(VariantConfig(), config)
    assert (one.recipe.package.name, str(one.recipe.package.version)) == (PROJECT["name"], PROJECT["version"])


def test_extras_are_those_that_are_named():
    of_work = {"ligands", "pka", "quality", "umbrella", "xtb", "aimnet2", "mace-off", "robots", "cluster"}
    named = {"cuda12", "cuda13", "hip", *of_work, "notebook", "test", "dev"}
    assert named == {*PROJECT["optional-dependencies"]}


@pytest.mark.parametrize("name", ["Containerfile", "protochain.def"])
def test_containers_run_as_a_user_with_kernels_of_no_single_processor(name):
    text = (PACKAGING / name).read_text(encoding="utf-8")
    assert "warm.sh" in text and "NUMBA_CPU_NAME=x86-64-v3" in text
    if name == "Containerfile":
        # Whoever compiled kernels runs them.
        assert text.index("\nUSER user") < text.index("RUN sh /opt/warm.sh")


@pytest.mark.slow
def test_the_wheel_relaxes_a_model_far_from_the_repository(tmp_path):
    """Where dependencies can be downloaded: into an empty environment, with what the wheel alone brings."""
    pip = [sys.executable, "-m", "pip"]
    if subprocess.run([*pip, "download", "-q", "--no-deps", "-d", tmp_path, "jsonschema"]).returncode:
        pytest.skip("no index of packages answers")
    subprocess.run([*pip, "wheel", "-q", "--no-deps", "-w", tmp_path, ROOT], check=True)
    (wheel,) = tmp_path.glob("protochain-*.whl")
    done = subprocess.run(
        [sys.executable, PACKAGING / "smoke.py", wheel], capture_output=True, text=True, check=True
    )
    assert f"{wheel.name}: converged" in done.stdout and "from wheel to relaxed model" in done.stdout
