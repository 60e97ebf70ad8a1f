"""The registry of tasks: what it finds, what it refuses, and what every entry promises."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.sim import tasks
from skewmi.sim.task_spec import Caption, TaskSpec
from skewmi.sim.tasks import registry

THIRD_PARTY = """
from dataclasses import replace
from skewmi.sim import tasks
SPEC = replace(tasks.find(tasks.default()), name={name!r})
"""


@pytest.fixture(params=tasks.names())
def spec(request: pytest.FixtureRequest) -> TaskSpec:
    return tasks.find(request.param)


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on the path, in which packages can be put; the registry is as before at the end."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(registry, "_registered", dict(registry._registered))
    for cached in (registry._of_other_packages, registry.find):
        cached.cache_clear()
    yield tmp_path
    for cached in (registry._of_other_packages, registry.find):
        cached.cache_clear()


def install(site: Path, task: str, where: str, text: str) -> None:
    """What pip leaves of a package with one module and one entry point."""
    module = where.partition(":")[0]
    (site / f"{module}.py").write_text(text)
    info = site / f"{module}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{registry.GROUP}]\n{task} = {where}\n")
    registry._of_other_packages.cache_clear()


def test_names_need_no_task_to_be_imported() -> None:
    script = "from skewmi.sim import tasks; import sys; tasks.names(); print(*sys.modules)"
    result = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    loaded = set(result.stdout.split())
    assert not loaded & {"mujoco", "gymnasium", *(f"skewmi.sim.tasks.{n}" for n in tasks.names())}


def test_the_default_is_the_first_and_has_an_arm() -> None:
    assert tasks.default() == tasks.names()[0]
    assert tasks.default() in tasks.with_arm()


def test_a_task_of_another_package_comes_after_ours(site: Path) -> None:
    ours = tasks.names()
    install(site, "sort_mail", "mail_task:SPEC", THIRD_PARTY.format(name="sort_mail"))
    assert tasks.names() == (*ours, "sort_mail")
    assert tasks.find("sort_mail").name == "sort_mail"
    assert tasks.layout("sort_mail").task == tasks.layout(tasks.default()).task
    assert tasks.default() == ours[0]


@pytest.mark.parametrize(
    ("task", "where", "text", "said"),
    [
        ("sort_mail", "mail:SPEC", "import nowhere_at_all", "mail:SPEC: No module named"),
        ("sort_mail", "mail:SPEC", "", "has no attribute 'SPEC'"),
        ("sort_mail", "mail:SPEC", "SPEC = 3", "but is 'a int'"),
        ("sort_mail", "mail:SPEC", THIRD_PARTY.format(name="other"), "but is 'other'"),
    ],
)
def test_what_is_no_task_is_refused_when_it_is_asked_for(
    site: Path, task: str, where: str, text: str, said: str
) -> None:
    install(site, task, where, text)
    sys.modules.pop("mail", None)
    assert task in tasks.names()
    with pytest.raises(ConfigurationError, match="sort_mail") as error:
        tasks.find(task)
    assert said in str(error.value)


def test_two_tasks_of_one_name_are_refused(site: Path) -> None:
    name = tasks.default()
    with pytest.raises(ConfigurationError, match="2 tasks are called"):
        tasks.register(name, "elsewhere:SPEC")
    install(site, name, "mine:SPEC", THIRD_PARTY.format(name=name))
    assert tasks.names().count(name) == 1
    with pytest.raises(ConfigurationError, match="2 tasks are called"):
        tasks.find(name)


def test_two_other_packages_with_a_task_of_one_name_are_refused(site: Path) -> None:
    install(site, "sort_mail", "mail_task:SPEC", THIRD_PARTY.format(name="sort_mail"))
    install(site, "sort_mail", "post_task:SPEC", THIRD_PARTY.format(name="sort_mail"))
    with pytest.raises(ConfigurationError, match=r"mail_task:SPEC.*post_task:SPEC|uninstall"):
        tasks.find("sort_mail")


def test_gymnasium_knows_a_task_of_another_package(site: Path) -> None:
    from skewmi.sim import gym_envs

    assert gym_envs.gym_id("sort_mail") == "skewmi/SortMail-v0"
    assert {gym_envs.gym_id(name) for name in tasks.names()} <= set(gym_envs.IDS)


@pytest.mark.parametrize("name", ["", "Sort", "sort-mail", "2sort", "sort mail"])
def test_a_name_that_flags_and_files_do_not_take_is_refused(site: Path, name: str) -> None:
    with pytest.raises(ConfigurationError, match="small letters"):
        tasks.register(name, "mail:SPEC")


def test_an_unknown_task_is_refused_with_those_that_exist() -> None:
    with pytest.raises(NotFoundError, match=", ".join(tasks.names())):
        tasks.find("sort_mail")


def test_every_layout_is_another_one_and_the_first_the_default(spec: TaskSpec) -> None:
    layouts = list(spec.layouts())
    assert len(layouts) == 2 ** len(spec.layout_switches) * max(len(spec.targets), 1)
    assert len({layout.hash() for _, layout in layouts}) == len(layouts)
    assert layouts[0] == ({}, spec.layout())
    for options, layout in layouts:
        assert layout.task == spec.name
        assert tasks.layout(spec.name, **options) == layout
        assert set(options) <= {*spec.layout_switches, "target"}


def test_everything_that_names_a_field_names_one_of_the_state(spec: TaskSpec) -> None:
    state = {field.name for field in spec.layout().state_fields}
    named = {axis.field for axis in spec.metrics.grid}
    named |= {c.field for event in spec.metrics.events for c in event.conditions}
    named |= {name for plane in spec.planes for name in plane}
    named |= {caption.field for caption in spec.captions}
    named |= set(spec.scene_fields.values())
    assert named <= state
    events = [event.name for event in spec.metrics.events]
    assert len(set(events)) == len(events)


def test_keys_of_variations_differ_and_bundled_files_are_valid(spec: TaskSpec) -> None:
    keys = [key.name for key in spec.variations.keys]
    assert len(set(keys)) == len(keys)
    assert all("." in key for key in keys)
    for name in spec.variations.bundled():
        assert not spec.variations.load(name).is_nominal


def test_what_varies_without_a_file_of_the_task_varies_with_the_arms(spec: TaskSpec) -> None:
    if spec.arm is None:
        assert not spec.variations.keys
        return
    generic = replace(spec.variations, packages=("skewmi.sim",))
    assert generic.bundled().keys() >= {"randomised"}
    generic.load("randomised")


@pytest.mark.parametrize(
    ("value", "said"),
    [(1.5708, "lid  90 deg"), (-1e-4, "lid   0 deg"), (0.0, "lid   0 deg"), (-0.02, "lid  -1 deg")],
)
def test_a_caption_rounds_and_never_says_minus_zero(value: float, said: str) -> None:
    assert Caption("angle", "lid", "deg", 57.29577951308232, 3).text(value) == said
