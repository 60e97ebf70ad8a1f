"""The compiled update computes what the one in single operations does, and who uses it when."""

from __future__ import annotations

import shutil
import sysconfig
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from sac_batches import batches
from train_runs import resumes_alike

from skewmi.errors import CheckpointError, ConfigurationError
from skewmi.train.sac import compiled as compiled_module
from skewmi.train.sac import engines as engines_module
from skewmi.train.sac.compiled import CompiledUpdate, can_compile
from skewmi.train.sac.config import SacConfig
from skewmi.train.sac.sac import Sac

CONFIG = SacConfig(hidden=(16, 16), engine="eager", learning_rate=3e-3)
COMPILED = replace(CONFIG, engine="compiled", compile_after=3)
needs_compiler = pytest.mark.skipif(
    not can_compile(torch.device("cpu")), reason="needs a C++ compiler"
)


@pytest.fixture
def without_code(monkeypatch: pytest.MonkeyPatch) -> list[CompiledUpdate]:
    """The function is captured whole, but its operations run one by one: no minute of compiling."""
    made: list[CompiledUpdate] = []

    def make(sac: Sac) -> CompiledUpdate:
        made.append(CompiledUpdate(sac, backend="eager"))
        return made[-1]

    monkeypatch.setattr(engines_module, "CompiledUpdate", make)
    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")
    monkeypatch.setattr(compiled_module, "has_headers", lambda: True)
    return made


def tensors(sac: Sac) -> dict[str, torch.Tensor]:
    found = {
        f"{kind}.{name}": value
        for kind in ("actor", "critics", "target")
        for name, value in sac.state_dict()[kind].items()
    }
    for kind in ("actor_optimizer", "critic_optimizer"):
        for index, entry in sac.state_dict()[kind].items():
            found |= {f"{kind}.{index}.{name}": value for name, value in entry.items()}
    return found | {"log_temperature": sac.log_temperature}


def learn_alike(config: SacConfig, compiled: SacConfig) -> None:
    """Both engines get the same batches, and say and become the same but for roundings."""
    one, other = (Sac(c, 5, 2, seed=0) for c in (config, compiled))
    for batch in batches(25):
        expected, got = one.update(batch), other.update(batch)
        assert got.keys() == expected.keys()
        for name, value in expected.items():
            torch.testing.assert_close(got[name], value.detach(), rtol=2e-4, atol=2e-5)
    assert (one.updates, other.updates) == (25, 25)
    theirs = tensors(other)
    for name, value in tensors(one).items():
        torch.testing.assert_close(theirs[name], value, rtol=2e-3, atol=2e-4, msg=name)
    # The random stream went on alike, and learning has happened.
    assert torch.equal(one.generator.get_state(), other.generator.get_state())
    fresh = tensors(Sac(CONFIG, 5, 2, seed=0))
    assert any(not torch.equal(fresh[name], theirs[name]) for name in fresh)


@pytest.mark.parametrize("target_entropy", [None, 0.5])
def test_both_learn_the_same(without_code, target_entropy: float | None) -> None:
    learn_alike(*(replace(c, target_entropy=target_entropy) for c in (CONFIG, COMPILED)))
    assert len(without_code) == 1


def test_goes_on_bit_for_bit_from_its_state(without_code) -> None:
    whole = Sac(COMPILED, 5, 2, seed=0)
    given = batches(12)
    for batch in given[:6]:
        whole.update(batch)
    parts = Sac(replace(COMPILED, engine="auto"), 5, 2, seed=1)
    parts.load_state_dict(deepcopy(whole.state_dict()))  # as from a file
    assert parts.engine == "compiled"
    for batch in given[6:]:
        one, other = whole.update(batch), parts.update(batch)
        assert all(torch.equal(one[name], other[name]) for name in one)
    ours = tensors(parts)
    assert all(torch.equal(value, ours[name]) for name, value in tensors(whole).items())
    # Moments that were loaded are other tensors: who keeps the old ones learns nothing more.
    whole.load_state_dict(deepcopy(parts.state_dict()))
    assert torch.equal(whole.update(given[0])["value"], parts.update(given[0])["value"])


def test_a_run_keeps_its_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled_module, "has_headers", lambda: True)
    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")
    eager, auto = Sac(CONFIG, 5, 2, seed=0), Sac(replace(CONFIG, engine="auto"), 5, 2, seed=0)
    assert (eager.engine, auto.engine) == ("eager", "compiled")
    compiled = auto.state_dict()
    auto.load_state_dict(eager.state_dict())
    assert auto.engine == "eager"
    older = {name: value for name, value in compiled.items() if name != "engine"}
    auto.load_state_dict(older)  # of before there was another
    assert auto.engine == "eager"
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert Sac(replace(CONFIG, engine="auto"), 5, 2, seed=0).engine == "eager"
    with pytest.raises(CheckpointError, match=r"install one.*--start-from RUN --learner.eng"):
        auto.load_state_dict(compiled)
    eager.load_state_dict(compiled)  # asked for by name
    assert eager.engine == "eager"
    with pytest.raises(ConfigurationError, match=r"C\+\+ compiler"):
        Sac(COMPILED, 5, 2, seed=0)


def test_a_compiler_that_fails_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled_module, "has_headers", lambda: True)
    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")

    def broken(*_: object) -> None:
        raise RuntimeError("Python.h: No such file\nmore")

    def make(sac: Sac) -> CompiledUpdate:
        made = CompiledUpdate(sac, backend="eager")
        made._update = broken  # type: ignore[assignment]
        return made

    monkeypatch.setattr(engines_module, "CompiledUpdate", make)
    sac = Sac(COMPILED, 5, 2, seed=0)
    given = batches(4)
    for batch in given[:3]:
        sac.update(batch)
    with pytest.raises(ConfigurationError, match=r"Python\.h: No such file\); .*engine eager"):
        sac.update(given[3])
    assert sac.updates == 3


def test_headers_are_needed_too(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")
    monkeypatch.setattr(sysconfig, "get_path", lambda name: str(tmp_path))
    assert not can_compile(torch.device("cpu"))
    (tmp_path / "Python.h").touch()
    assert can_compile(torch.device("cpu"))
    assert not can_compile(torch.device("meta"))


@pytest.mark.parametrize("numbers", [{"engine": "fast"}, {"compile_after": 0}])
def test_numbers_that_make_no_sense_are_refused(numbers: dict) -> None:
    with pytest.raises(ConfigurationError, match=next(iter(numbers))):
        SacConfig(**numbers)


@pytest.mark.slow
@needs_compiler
def test_code_learns_the_same() -> None:
    learn_alike(CONFIG, COMPILED)


@pytest.mark.slow
@needs_compiler
def test_compiled_run_resumes_bit_identically(tmp_path, make_corridor, corridor_config) -> None:
    learner = replace(corridor_config.learner, engine="compiled", compile_after=20)
    config = replace(corridor_config, learner=learner, total_steps=1200)
    resumes_alike(config, make_corridor, tmp_path, 600)
