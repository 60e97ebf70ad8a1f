"""Sweep files: read strictly, with messages that say where and what is allowed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.sweep.sweep_file import Part, narrowed, parse_sweep, read_sweep_file

SHORT = "groups: {a: {tasks: [t], configurations: [p]}}"
FILES = sorted((Path(__file__).parents[2] / "sweeps").glob("*.yaml"))


def test_what_is_left_out_has_a_default() -> None:
    sweep = parse_sweep(SHORT, "f")
    (group,) = sweep.groups
    assert (sweep.threads, group.seeds, group.targets, group.keep_states) == (
        1,
        (0,),
        (None,),
        False,
    )
    assert [(c.name, c.preset) for c in group.configurations] == [("p", "p")]


def test_the_narrower_place_wins() -> None:
    sweep = parse_sweep(
        """
        seeds: 2
        set: {total_steps: 1, minutes: 1}
        groups:
          a:
            tasks: [t]
            seeds: [7]
            set: {total_steps: 2, learner.n_step: 2}
            options: {time_input: true}
            configurations: [{preset: p, set: {learner.n_step: 3}, options: {start_noise: 0.1}}, q]
        """,
        "f",
    )
    first, second = sweep.groups[0].configurations
    assert sweep.groups[0].seeds == (7,)
    assert first.numbers == {"total_steps": 2, "minutes": 1, "learner.n_step": 3}
    assert second.numbers == {"total_steps": 2, "minutes": 1, "learner.n_step": 2}
    assert first.options == {"time_input": True, "start_noise": 0.1}


@pytest.mark.parametrize("wide", ["steps", "total-steps", "total_steps"])
@pytest.mark.parametrize("narrow", ["steps", "total-steps", "total_steps"])
def test_the_narrower_place_wins_however_either_writes_a_number(wide: str, narrow: str) -> None:
    sweep = parse_sweep(
        f"set: {{{wide}: 1, rollout.num-envs: 1}}\n"
        "groups:\n"
        "  a:\n"
        "    tasks: [t]\n"
        f"    set: {{{narrow}: 2, rollout.num_envs: 2}}\n"
        f"    configurations: [p, {{preset: q, set: {{{wide}: 3, rollout.num-envs: 3}}}}]",
        "f",
    )
    group, own = sweep.groups[0].configurations
    assert group.numbers == {"total_steps": 2, "rollout.num_envs": 2}
    assert own.numbers == {"total_steps": 3, "rollout.num_envs": 3}
    (tried,) = narrowed(sweep, Part(configurations=["q"], steps=4)).groups
    assert tried.configurations[0].numbers == {"total_steps": 4, "rollout.num_envs": 3}


@pytest.mark.parametrize(
    ("text", "where"),
    [
        (f"set: SET\n{SHORT}", "f, set"),
        ("groups: {a: {tasks: [t], configurations: [p], set: SET}}", "f, group a, set"),
        (
            "groups: {a: {tasks: [t], configurations: [{name: n, preset: p, set: SET}]}}",
            "f, group a, configuration n, set",
        ),
    ],
)
@pytest.mark.parametrize(
    ("numbers", "says"),
    [
        ("{steps: 1, total_steps: 1}", "total_steps is given twice, as 'steps' and 'total_steps'"),
        ("{total_steps: 1, total-steps: 2}", "as 'total_steps' and 'total-steps'"),
        ("{learner.n-step: 1, learner.n_step: 1}", "learner.n_step is given twice"),
    ],
)
def test_a_number_that_is_set_twice_in_one_place_is_refused(
    text: str, where: str, numbers: str, says: str
) -> None:
    with pytest.raises(ConfigurationError) as error:
        parse_sweep(text.replace("SET", numbers), "f")
    assert str(error.value).startswith(f"{where}: ")
    assert says in str(error.value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "f: None is given where a mapping is needed"),
        ("groups: {}", "nothing to run"),
        ("grops: {}", "unknown 'grops'; allowed: seeds, threads, set, groups, figures"),
        ("groups: {a: {tasks: [t]}}", "configurations must be a list"),
        ("groups: {a: {configurations: [p]}}", "group a, tasks: None"),
        ("groups: {a: {tasks: [t], configurations: [p], sets: 1}}", "group a: unknown 'sets'"),
        ("groups: {a: {tasks: [t], configurations: [{name: n}]}}", "needs a preset"),
        ("groups: {a: {tasks: [t], configurations: [p, p]}}", "p is there twice"),
        ("groups: {a: {tasks: [t, t], configurations: [p]}}", "t is there twice"),
        ("groups: {a: {tasks: t, configurations: [p]}}", "a list of names is needed"),
        ("groups: {a: {tasks: [t], configurations: [p], keep_states: 1}}", "not of type bool"),
        (f"seeds: 0\n{SHORT}", "seeds 0"),
        (f"seeds: [1, 1]\n{SHORT}", "list of different"),
        (f"seeds: [-1]\n{SHORT}", "natural numbers"),
        (f"seeds: true\n{SHORT}", "seeds True"),
        (f"threads: two\n{SHORT}", "threads: 'two' is not of type int"),
        (f"set: 3\n{SHORT}", "f, set: 3"),
        ("a: [", "is not YAML"),
    ],
)
def test_what_is_not_allowed_is_refused(text: str, says: str) -> None:
    with pytest.raises(ConfigurationError) as error:
        parse_sweep(text, "f")
    assert says in str(error.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match=r"docs/sweep.md"):
        read_sweep_file(tmp_path / "none.yaml")


def test_there_are_sweeps_for_the_publication() -> None:
    assert {path.stem for path in FILES} >= {"paper", "paper-reduced", "smoke"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_sweeps_that_come_with_the_source_are_read(path: Path) -> None:
    sweep = read_sweep_file(path)
    assert sweep.groups
    assert sweep.figures


def test_a_part_of_a_sweep() -> None:
    sweep = parse_sweep(
        "set: {steps: 9}\n"
        "groups:\n"
        "  a: {tasks: [t], configurations: [p, q], seeds: [5, 6, 7]}\n"
        "  b: {tasks: [t], configurations: [p], set: {total_steps: 8}}",
        "f",
    )
    assert narrowed(sweep, Part()) == sweep
    (group,) = narrowed(sweep, Part(groups=["a"], seeds=2, steps=3)).groups
    assert (group.name, group.seeds) == ("a", (5, 6))
    assert [dict(c.numbers) for c in group.configurations] == [{"total_steps": 3}] * 2
    with pytest.raises(NotFoundError, match="no group c; groups are a, b"):
        narrowed(sweep, Part(groups=["c"]))


def test_tasks_and_configurations_are_kept_in_every_group_that_has_them() -> None:
    sweep = parse_sweep(
        "groups:\n"
        "  a: {tasks: [t, u], configurations: [p, {name: 'x, y', preset: q}]}\n"
        "  b: {tasks: [u], configurations: [r, p]}\n"
        "  c: {tasks: [t], configurations: [r]}\n",
        "f",
    )

    def kept(**part: Any) -> dict[str, tuple[tuple[str, ...], list[str]]]:
        groups = narrowed(sweep, Part(**part)).groups
        return {
            group.name: (group.tasks, [c.name for c in group.configurations]) for group in groups
        }

    assert kept(configurations=["p"]) == {"a": (("t", "u"), ["p"]), "b": (("u",), ["p"])}
    assert kept(configurations=["x, y"]) == {"a": (("t", "u"), ["x, y"])}
    assert kept(tasks=["t"]) == {"a": (("t",), ["p", "x, y"]), "c": (("t",), ["r"])}
    assert kept(tasks=["u"], configurations=["r"], groups=["b", "c"]) == {"b": (("u",), ["r"])}
    with pytest.raises(NotFoundError, match='no configuration z; configurations are p, "x, y", r'):
        kept(configurations=["z"])
    with pytest.raises(NotFoundError, match="no task u; tasks are t"):
        kept(groups=["c"], tasks=["u"])
    with pytest.raises(NotFoundError, match='no group has configuration "x, y" on task u'):
        narrowed(
            parse_sweep(
                "groups:\n"
                "  a: {tasks: [t], configurations: [{name: 'x, y', preset: q}]}\n"
                "  b: {tasks: [u], configurations: [p]}\n",
                "f",
            ),
            Part(tasks=["u"], configurations=["x, y"]),
        )
