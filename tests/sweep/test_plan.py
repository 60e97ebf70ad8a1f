"""From sweep files to runs: each training once, however it is asked for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.policy_io import PolicyLayout
from skewmi.sweep.plan import Plan, make_plan, require_same_runs
from skewmi.sweep.sweep_file import parse_sweep
from skewmi.train.checkpoint import write_run_header
from skewmi.train.config import TrainConfig
from skewmi.train.exploration.rnd import RndConfig
from skewmi.train.ppo.config import PpoConfig
from skewmi.train.presets import default_preset


def start(task: str, preset: str) -> TrainConfig:
    """Presets of any task: `a` and `b`."""
    if preset not in ("a", "b"):
        raise NotFoundError(f"no preset {preset!r}; there are a, b")
    config = replace(default_preset(task), preset=preset, task_options=(("time_input", True),))
    return replace(config, total_steps=100 if preset == "a" else 200)


def plan(groups: str, top: str = "") -> Plan:
    return make_plan(parse_sweep(f"{top}\ngroups:\n{groups}", "f"), start)


def test_every_combination_is_a_run() -> None:
    found = plan(
        "  g: {tasks: [t, u], targets: [x, y, z], configurations: [a, b], seeds: 4}\n"
        "  h: {tasks: [t], configurations: [a]}"
    )
    assert len(found.members) == 2 * 3 * 2 * 4 + 1
    assert len(found.runs) == len({run.name for run in found.runs}) == len(found.members)
    for run in found.runs:
        assert dict(run.config.task_options)["time_input"] is True
    # First seeds first: a figure of all configurations exists as early as it can.
    seeds = [run.config.seed for run in found.runs]
    assert seeds == sorted(seeds)


def test_groups_that_ask_for_the_same_training_share_it() -> None:
    found = plan(
        "  g: {tasks: [t], configurations: [a, b]}\n"
        "  h:\n"
        "    tasks: [t]\n"
        "    configurations:\n"
        "      - {name: said again, preset: a, set: {steps: 100, exploration.sigma: 0.7}}\n"
        "      - {name: other, preset: a, set: {exploration.sigma: 0.8}}"
    )
    first, second, again, other = found.members
    assert first.run.name == again.run.name
    assert len({first.run.name, second.run.name, other.run.name}) == 3
    assert again.run.changes == {}
    assert other.run.changes == {"exploration.sigma": 0.8}
    assert len(found.runs) == 3


def test_a_name_is_of_what_a_run_is_and_not_of_its_place_or_threads() -> None:
    one = plan("  g: {tasks: [t], configurations: [a, b], seeds: 2}")
    two = plan("  h: {tasks: [t], configurations: [b], seeds: [1]}", "threads: 2")
    assert two.runs[0].name in {run.name for run in one.runs}
    assert two.runs[0].config.threads == 2


def test_numbers_methods_and_options_arrive() -> None:
    found = plan(
        "  g:\n"
        "    tasks: [t]\n"
        "    targets: [far]\n"
        "    options: {start_noise: 0.1}\n"
        "    configurations: [{preset: a, learner: ppo, exploration: rnd, set: {learner.clip: 1,\n"
        "      rollout.random-steps: 0, stop_on_convergence: true, minutes: 2}}]"
    )
    config = found.runs[0].config
    assert config.learner == PpoConfig(clip=1.0)
    assert config.exploration == RndConfig()
    assert (config.stop_on_convergence, config.minutes) == (True, 2.0)
    assert config.rollout.random_steps == 0
    options = {"time_input": True, "start_noise": 0.1, "target": "far"}
    assert dict(config.task_options) == options
    assert "far" in found.runs[0].name


def test_a_run_has_the_number_of_its_configuration_however_its_group_writes_it() -> None:
    found = plan(
        "  g:\n"
        "    tasks: [t]\n"
        "    set: {steps: 2000, rollout.num-envs: 10}\n"
        "    configurations:\n"
        "      - {preset: a, set: {total_steps: 1000, rollout.num_envs: 3}}\n"
        "      - b",
        "set: {total_steps: 400000, rollout.num_envs: 5}",
    )
    own, group = (run.config for run in found.runs)
    assert (own.total_steps, own.rollout.num_envs) == (1000, 3)
    assert (group.total_steps, group.rollout.num_envs) == (2000, 10)


@pytest.mark.parametrize(
    "said",
    [
        "options: {target: x}, configurations: [a]",
        "configurations: [{preset: a, options: {target: x}}]",
    ],
)
def test_a_target_that_is_also_an_option_is_refused(said: str) -> None:
    """One would silently beat the other; alone each does."""
    (run,) = plan(f"  g: {{tasks: [t], {said}}}").runs
    assert dict(run.config.task_options)["target"] == "x"
    with pytest.raises(ConfigurationError, match="'target' is given beside the group's targets"):
        plan(f"  g: {{tasks: [t], targets: [y], {said}}}")


@pytest.mark.parametrize(
    ("configuration", "says"),
    [
        ("c", "group g, configuration c: no preset 'c'"),
        (
            "{preset: a, set: {learner.n_steps: 1}}",
            "no number 'learner.n_steps'; numbers of learner",
        ),
        ("{preset: a, set: {learner.n_steps: 1}}", "learner.n_step,"),
        ("{preset: a, set: {learner.name: ppo}}", "no number 'learner.name'"),
        ("{preset: a, set: {seed: 1}}", "no number 'seed'; there are "),
        ("{preset: a, set: {task: u}}", "no number 'task'"),
        ("{preset: a, set: {sigma: 1}}", "no number 'sigma'"),
        ("{preset: a, set: {learner.n_step: 0}}", "n_step is 0, needs at least 1"),
        ("{preset: a, set: {learner.n_step: many}}", "'many' is not of type int"),
        ("{preset: a, learner: dqn}", "no learner 'dqn'; there are sac"),
        ("{preset: a, options: {seed: 1}}", "option 'seed' cannot be given"),
        ("{preset: a, options: {start_noise: [1]}}", "is not a number, a word"),
    ],
)
def test_what_a_run_cannot_be_is_refused(configuration: str, says: str) -> None:
    with pytest.raises((ConfigurationError, NotFoundError)) as error:
        plan(f"  g: {{tasks: [t], configurations: [{configuration}]}}")
    assert says in str(error.value)
    assert str(error.value).startswith("group g, configuration")


def test_a_run_of_a_preset_that_has_changed_is_refused(
    tmp_path: Path, layout: PolicyLayout
) -> None:
    found = plan("  g: {tasks: [t], configurations: [a]}")
    (run,) = found.runs
    require_same_runs(found, tmp_path)
    # Threads are the machine's; a run keeps those that it began with.
    write_run_header(tmp_path / run.name, replace(run.config, threads=5), layout)
    require_same_runs(found, tmp_path)
    exploration = replace(run.config.exploration, sigma=3.0)  # type: ignore[call-arg]
    write_run_header(tmp_path / run.name, replace(run.config, exploration=exploration), layout)
    with pytest.raises(ConfigurationError, match=r"exploration.sigma 3.0 \(now 0.7\)"):
        require_same_runs(found, tmp_path)
