"""Grippers, and Robot Web Services against a small server that answers as RobotWare 6 does."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import pytest
from rws_server import RwsServer

from skewmi.deploy.robot.gripper import rws
from skewmi.deploy.robot.gripper.fixed import FixedGripper
from skewmi.deploy.robot.gripper.rws import MODULE, STATE, TARGET, TASK, GripperState, RwsGripper
from skewmi.deploy.robot.gripper.rws_client import RwsClient
from skewmi.errors import CommandRefusedError, ConfigurationError, TransportError

STATE_PATH = f"{TASK}/{MODULE}/{STATE}"
TARGET_PATH = f"{TASK}/{MODULE}/{TARGET}"


@pytest.fixture
def server() -> Iterator[RwsServer]:
    with RwsServer({STATE_PATH: "[14,1,0,1]", TARGET_PATH: "0"}) as running:
        yield running


class RapidTask:
    """What `SkewmiGrip.mod` does: rounds, in each of which the fingers go to their target."""

    def __init__(self, server: RwsServer) -> None:
        self._server = server
        self._ended = threading.Event()
        self.calibrated, self.error = 1, 0
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> RapidTask:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        beats = 0
        while not self._ended.wait(0.02):
            beats += 1
            mm = self._server.symbols[TARGET_PATH]
            state = f"[{mm},{self.calibrated},{self.error},{beats}]"
            self._server.symbols[STATE_PATH] = state


@pytest.fixture
def gripper(server: RwsServer) -> Iterator[RwsGripper]:
    opened = RwsGripper.open(RwsClient(server.url, timeout_s=5.0), 0.010)
    yield opened
    opened.close()


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_symbols_are_read_and_written_with_one_session(server: RwsServer) -> None:
    client = RwsClient(server.url)
    assert client.read_symbol(TASK, MODULE, STATE) == "[14,1,0,1]"
    client.write_symbol(TASK, MODULE, TARGET, "12.50")
    assert client.read_symbol(TASK, MODULE, TARGET) == "12.50"
    assert server.writes == [(TARGET_PATH, "12.50")]
    assert server.challenges == 1
    assert server.sessions == 1


@pytest.mark.parametrize("how", ["too late", "forgotten"])
def test_a_target_that_could_not_be_told_is_not_told_much_later(
    server: RwsServer, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    """Nobody is there any more who wanted the fingers to close when a cable is plugged in again."""
    monkeypatch.setattr(rws, "TOLD_WITHIN_S", 0.3 if how == "too late" else 60.0)
    client = RwsClient(server.url, timeout_s=5.0)
    broken = threading.Event()
    write = client.write_symbol
    tried = []

    def write_symbol(*arguments: str) -> None:
        tried.append(arguments)
        if broken.is_set():
            raise TransportError("the cable is out")
        write(*arguments)

    monkeypatch.setattr(client, "write_symbol", write_symbol)
    with RapidTask(server):
        gripper = RwsGripper.open(client, 0.010)
        try:
            until(lambda: gripper.problem() is None)
            broken.set()
            gripper.open_to(0.0)
            until(lambda: len(tried) >= 2)
            if how == "too late":
                time.sleep(0.5)
            else:
                gripper.forget()
            said = len(tried)
            broken.clear()
            time.sleep(0.5)
            assert len(tried) <= said + 1
            assert server.writes == []
            gripper.open_to(0.005)
            until(lambda: server.writes == [(TARGET_PATH, "5.00")])
        finally:
            gripper.close()


def test_a_wrong_password_is_told(server: RwsServer) -> None:
    with pytest.raises(TransportError, match="401"):
        RwsClient(server.url, password="wrong").read_symbol(TASK, MODULE, STATE)


def test_what_is_not_there_is_told(server: RwsServer) -> None:
    with pytest.raises(TransportError, match="RESOURCE_NOT_FOUND"):
        RwsClient(server.url).read_symbol(TASK, MODULE, "nothing")


@pytest.mark.parametrize("answer", [b"", b"<html>", b"{}", b'{"_embedded": {"_state": []}}', b"[]"])
def test_an_answer_of_another_kind_is_told(server: RwsServer, answer: bytes) -> None:
    server.broken = answer
    with pytest.raises(TransportError, match=STATE):
        RwsClient(server.url).read_symbol(TASK, MODULE, STATE)


def test_nobody_there_is_told() -> None:
    with pytest.raises(TransportError, match="does not answer"):
        RwsClient("http://127.0.0.1:9", timeout_s=1.0).read_symbol(TASK, MODULE, STATE)


@pytest.mark.parametrize("url", ["192.168.125.1", "https://192.168.125.1", "http://", "http://a/b"])
def test_addresses_are_checked(url: str) -> None:
    with pytest.raises(ConfigurationError, match="Robot Web Services"):
        RwsClient(url)


@pytest.mark.parametrize("text", ["", "14", "[14,1,0]", "[a,1,0,1]", "[14,1,0,1,2]"])
def test_a_state_of_another_version_is_told(text: str) -> None:
    with pytest.raises(TransportError, match=f"{MODULE}.mod"):
        GripperState.parse(text)


def test_fingers_move_through_the_task(server: RwsServer, gripper: RwsGripper) -> None:
    with RapidTask(server):
        until(lambda: gripper.problem() is None)
        gripper.open_to(0.020)
        until(lambda: gripper.opening == pytest.approx(0.020))
    assert server.writes[-1] == (TARGET_PATH, "20.00")


def test_the_newest_target_wins(server: RwsServer, gripper: RwsGripper) -> None:
    with RapidTask(server):
        until(lambda: gripper.problem() is None)
        for mm in range(1, 25):
            gripper.open_to(mm / 1e3)
        until(lambda: gripper.opening == pytest.approx(0.024))
    assert len(server.writes) < 24


def test_not_there_is_told(gripper: RwsGripper, monkeypatch: pytest.MonkeyPatch) -> None:
    # The server answers, but no task counts its rounds.
    monkeypatch.setattr(rws, "SILENT_S", 0.3)
    until(lambda: "does not run" in str(gripper.problem()))
    with pytest.raises(CommandRefusedError, match="not there"):
        gripper.open_to(0.010)


def test_not_calibrated_is_told(server: RwsServer, gripper: RwsGripper) -> None:
    with RapidTask(server) as task:
        until(lambda: gripper.problem() is None)
        task.calibrated = 0
        until(lambda: "not calibrated" in str(gripper.problem()))
        with pytest.raises(CommandRefusedError, match="not calibrated"):
            gripper.open_to(0.010)
        task.calibrated, task.error = 1, 5
        until(lambda: "error 5" in str(gripper.problem()))


def test_a_controller_that_goes_away_is_told_and_found_again(
    server: RwsServer, gripper: RwsGripper
) -> None:
    with RapidTask(server):
        until(lambda: gripper.problem() is None)
        server.broken = b"rebooting"
        until(lambda: "rebooting" in str(gripper.problem()))
        server.broken = None
        until(lambda: gripper.problem() is None)


@pytest.mark.parametrize("opening", [-0.001, 0.026, float("nan")])
def test_what_is_no_opening_is_refused(gripper: RwsGripper, opening: float) -> None:
    for one in (gripper, FixedGripper(0.014)):
        with pytest.raises(CommandRefusedError, match="outside"):
            one.open_to(opening)


def test_fixed_fingers_stay() -> None:
    fixed = FixedGripper(0.014)
    fixed.open_to(0.0142)
    assert fixed.opening == 0.014
    assert fixed.problem() is None
    with pytest.raises(CommandRefusedError, match="14 mm"):
        fixed.open_to(0.020)
    with pytest.raises(ConfigurationError, match="fixed gripper"):
        FixedGripper(0.1)
    fixed.close()
