"""The EGM bridge and an emulated controller in the place of the simulated robot server.

Run as a script it is one of the two children. `bridge` is the product's command with a plan that
is written down, `emulator` the product's command with a controller that does as it is told on its
standard input, a line each time. `EgmRobot` is the parent's handle of both.
"""

from __future__ import annotations

import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from fault_robot import LOG_VARIABLE, RESET, STEP, TAKEN, Robot

from skewmi.cli.main import main
from skewmi.deploy.robot import controller as controller_module
from skewmi.deploy.robot.backend import RobotState
from skewmi.deploy.robot.backends.egm.codec import encode_feedback
from skewmi.deploy.robot.backends.egm.packets import FeedbackPacket
from skewmi.deploy.robot.description import RobotDescription
from skewmi.deploy.robot.egm_emulator.controller_states import ArmEvent
from skewmi.deploy.robot.egm_emulator.emulator import Emulator
from skewmi.deploy.robot.egm_emulator.wires import NetworkOptions, Wires
from skewmi.deploy.robot.follower import PlanFollower
from skewmi.deploy.robot.process import free_port
from skewmi.deploy.wire import topics
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import TransportError
from skewmi.policy_io import Array
from skewmi.trajectory import GRID_NS

COMM_TIMEOUT_S = "0.1"
LAG_MS = "10"
JITTER_NS = 20_000_000
COUNTED = ("doubled", "overtaken", "spoiled", "foreign", "late", "not_numbers", "overload")
"""Of the orders: attributes of `ToldWires`, each with a number of packets."""
FOUND_S = 30.0
"""How long bridge and emulator may take to find one another."""


class WatchedFollower(PlanFollower):
    """It, and a row in a file for every point of the grid that the plan has passed while it was
    followed; what is sent to the controller lies between them."""

    def __init__(self, *args: object, **options: object) -> None:
        self._log = os.open(os.environ[LOG_VARIABLE], os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        super().__init__(*args, **options)  # type: ignore[arg-type]
        self._next = RESET
        """Kind of the next row."""

    def cycle(self, state: RobotState) -> None:
        before_ns = self.executed_ns
        if not state.guided and self._next == STEP:
            self._next = RESET if self.at_rest else TAKEN
        try:
            super().cycle(state)
        finally:
            first_ns = before_ns - before_ns % GRID_NS + GRID_NS
            for tick_ns in range(first_ns, self.executed_ns + 1, GRID_NS):
                self._write(self._next, self.plan.at(tick_ns).q)
                self._next = STEP
            if not state.guided:
                self._next = RESET

    def rest_at(self, q: Array) -> None:
        if self._next == STEP:
            self._next = RESET if self.at_rest else TAKEN
        super().rest_at(q)

    def _write(self, kind: float, commanded: Array) -> None:
        row = np.concatenate([[kind, time.monotonic()], commanded, self.measured])
        os.write(self._log, row.astype("<f8").tobytes())


class ToldWires(Wires):
    """Wires that can be told to lose, double, delay or spoil what they carry."""

    silent_until_s = mute_until_s = 0.0
    doubled = overtaken = spoiled = foreign = 0
    """So many of the coming packets."""
    late = not_numbers = overload = 0
    _held: FeedbackPacket | None = None
    _other: socket.socket | None = None

    @staticmethod
    def open(remote: tuple[str, int], options: NetworkOptions) -> ToldWires:
        return ToldWires(Wires.open(remote, options)._socket, options)

    def send(self, packet: FeedbackPacket, now_ns: int) -> None:
        if time.monotonic() < self.silent_until_s:
            return
        packet = self._as_told(packet)
        if self.overtaken > 0:
            # Two packets change places.
            self.overtaken -= 1
            held, self._held = self._held, packet if self._held is None else None
            if held is None:
                return
            super().send(packet, now_ns)
            packet = held
        super().send(packet, now_ns)
        if self.doubled > 0:
            self.doubled -= 1
            super().send(packet, now_ns)
        if self.spoiled > 0:
            self.spoiled -= 1
            self._socket.send(os.urandom(200))
        if self.foreign > 0:
            self.foreign -= 1
            self._send_from_elsewhere(packet)

    def _as_told(self, packet: FeedbackPacket) -> FeedbackPacket:
        """The packet with what is wrong about it, and how late it and its answer will be."""
        self._jitter_ns = JITTER_NS if self.late > 0 else 0
        self.late -= 1
        if self.not_numbers > 0:
            self.not_numbers -= 1
            packet = replace(packet, q=np.where(np.arange(7) == 2, np.nan, packet.q))
        if self.overload > 0:
            self.overload -= 1
            packet = replace(packet, utilization=150.0)
        return packet

    def _send_from_elsewhere(self, packet: FeedbackPacket) -> None:
        """What another controller would say: of other joints, and newer."""
        if self._other is None:
            self._other = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._other.connect(self._socket.getpeername())
        other = replace(packet, q=packet.q + 0.1, sequence=packet.sequence + 10)
        self._other.send(encode_feedback(other))

    def carry(self, now_ns: int) -> None:
        super().carry(now_ns)
        if time.monotonic() < self.mute_until_s:
            self.clear()


def _act(emulator: Emulator, order: str) -> None:
    """Do what a line says, in the controller's own thread."""
    arm, wires = emulator.controller.arms["right"], emulator.controller.wires["right"]
    assert isinstance(wires, ToldWires)
    what, _, value = order.partition(" ")
    if what == "silent":
        wires.silent_until_s = time.monotonic() + float(value)
    elif what == "mute":
        wires.mute_until_s = time.monotonic() + float(value)
    elif what in COUNTED:
        setattr(wires, what, int(value))
    elif what == "motors":
        emulator.controller.switch_motors(on=value == "on")
    elif what == "stop":
        arm.stop()
    elif what == "end":
        arm.machine.fire(ArmEvent.CONVERGED, order, 0)
    elif what == "fail":
        arm.machine.fire(ArmEvent.OUT_OF_RANGE, order, 0)
    elif what == "start":
        arm.start()
    elif what == "restart":
        arm.restart_controller(emulator.simulation.robot_state(0).position[:7])
        arm.start()
    else:
        raise ValueError(order)


def _listen_to_orders() -> None:
    """Orders come from standard input; its end ends the emulator."""
    orders: queue.SimpleQueue[str] = queue.SimpleQueue()
    cycle: Callable[[Emulator, int], None] = Emulator.cycle

    def told_cycle(emulator: Emulator, now_ns: int) -> None:
        while not orders.empty():
            _act(emulator, orders.get())
        cycle(emulator, now_ns)

    def read() -> None:
        for line in sys.stdin:
            orders.put(line.strip())
        os.kill(os.getpid(), signal.SIGTERM)

    Emulator.cycle = told_cycle  # type: ignore[method-assign]
    threading.Thread(target=read, daemon=True).start()


class EgmRobot(Robot):
    """Bridge and emulator; satisfies what cells ask of `Robot`, which here means the bridge.

    Args:
        log: File for the rows; kept over restarts.
        environment: Added to the children's.
    """

    def __init__(self, log: Path, environment: dict[str, str] | None = None) -> None:
        super().__init__(log, lock_step=False, environment=environment)
        self._egm = f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
        self._emulator: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start what is not there, and wait until a session can use it."""
        if self._child is None:
            options = ["--listen", self.locator, "--egm-listen", self._egm, "--end-with-input"]
            options += ["--egm-listen-left", "none"]
            self._child = self._spawn("bridge", "egm", options)
        if self._emulator is None:
            options = ["--egm-remote", self._egm, "--connect", self.locator]
            options += ["--egm-comm-timeout-s", COMM_TIMEOUT_S, "--egm-lag-ms", LAG_MS]
            self._emulator = self._spawn("emulator", "egm-emulator", options)
        self._until_found()

    def tell(self, order: str) -> None:
        """To the emulator: see `_act`."""
        assert self._emulator is not None
        assert self._emulator.stdin is not None
        self._emulator.stdin.write(f"{order}\n".encode())
        self._emulator.stdin.flush()

    def end_emulator(self, number: int) -> None:
        """Send the emulator a signal and wait."""
        assert self._emulator is not None
        self._emulator.send_signal(number)
        self._emulator.wait(10.0)
        for pipe in (self._emulator.stdin, self._emulator.stdout):
            if pipe is not None:
                pipe.close()
        self._emulator = None

    def __exit__(self, *_: object) -> None:
        super().__exit__()
        if self._emulator is not None:
            self.end_emulator(signal.SIGKILL)

    def _spawn(self, role: str, backend: str, options: list[str]) -> subprocess.Popen[bytes]:
        command = [sys.executable, __file__, role, "robot", "--backend", backend, "--json"]
        child = subprocess.Popen(
            [*command, *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=self._environment,
        )
        assert child.stdout is not None
        assert child.stdout.readline(), f"the {role} did not start"
        return child

    def _until_found(self) -> None:
        deadline = time.monotonic() + FOUND_S
        said = "nothing"
        with Link.open(TransportConfig.for_client(self.locator), "watcher") as link:
            while time.monotonic() < deadline:
                try:
                    answer = link.call(topics.YUMI_DESCRIBE, 5.0)
                except TransportError as error:
                    said = str(error)
                    continue
                found = RobotDescription.from_json(answer.message)
                if found.ready and found.resettable:
                    return
                said = found.not_ready or "no emulator with a scene"
                time.sleep(0.05)
        raise AssertionError(f"bridge and emulator did not find one another: {said}")


if __name__ == "__main__":
    role = sys.argv[1]
    if role == "bridge":
        controller_module.PlanFollower = WatchedFollower  # type: ignore[misc]
    else:
        from skewmi.deploy.robot.egm_emulator import emulator as emulator_module

        emulator_module.Wires = ToldWires  # type: ignore[misc]
        _listen_to_orders()
    sys.exit(main(sys.argv[2:]))
