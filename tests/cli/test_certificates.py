"""`skewmi certificates`: what it writes, with which rights, and that nothing is lost."""

from __future__ import annotations

import builtins
import datetime
import ipaddress
import json
import os
import re
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from cryptography.x509.verification import PolicyBuilder, Store, VerificationError

from skewmi.cli.main import main

ROLES = ("robot", "commander", "observer")
FILES = {"authority.pem", "certificate.pem", "key.pem", "zenoh.json5"}


def make(out: Path, *options: str) -> int:
    return main(["certificates", "--out", str(out), "--host", "robot.lab", "10.0.0.7", *options])


def certificate(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(path.read_bytes())


def content(directory: Path) -> dict[str, bytes]:
    return {str(p.relative_to(directory)): p.read_bytes() for p in directory.rglob("*.*")}


def test_a_folder_for_each_role_that_is_complete(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "deep" / "link"
    before = datetime.datetime.now(datetime.UTC)
    assert make(out, "--days", "7", "--json") == 0
    said = json.loads(capsys.readouterr().out)
    expires = datetime.datetime.fromisoformat(said["expires"])
    assert abs(expires - before - datetime.timedelta(days=7)) < datetime.timedelta(minutes=5)
    assert said["zenoh_config"] == {r: str(out / r / "zenoh.json5") for r in ROLES}
    for role in ROLES:
        assert {path.name for path in (out / role).iterdir()} == FILES
    assert [path.name for path in out.parent.iterdir()] == ["link"], "drafts were left behind"
    # The authority's key is nowhere: each of the three keys is that of its own certificate.
    authority = certificate(out / "robot/authority.pem")
    for role in ROLES:
        key = load_pem_private_key((out / role / "key.pem").read_bytes(), None)
        assert isinstance(key, ec.EllipticCurvePrivateKey)
        assert key.public_key() == certificate(out / role / "certificate.pem").public_key()
        assert key.public_key() != authority.public_key()
        assert (out / role / "authority.pem").read_bytes() == (
            out / "robot/authority.pem"
        ).read_bytes()


def test_private_keys_are_their_owners_alone_whatever_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o000)
    try:
        assert make(tmp_path / "link") == 0
    finally:
        os.umask(before)
    for path in (tmp_path / "link", *(tmp_path / "link").rglob("*")):
        mode = stat.S_IMODE(path.stat().st_mode)
        if path.is_dir():
            assert mode == 0o700, path
        else:
            assert mode == (0o600 if path.name == "key.pem" else 0o644), path


def test_certificates_verify_for_their_own_purpose_only(tmp_path: Path) -> None:
    assert make(tmp_path) == 0
    leaves = {role: certificate(tmp_path / role / "certificate.pem") for role in ROLES}
    builder = PolicyBuilder().store(Store([certificate(tmp_path / "robot/authority.pem")]))
    for host in (x509.DNSName("robot.lab"), x509.IPAddress(ipaddress.ip_address("10.0.0.7"))):
        builder.build_server_verifier(host).verify(leaves["robot"], [])
    with pytest.raises(VerificationError):
        builder.build_server_verifier(x509.DNSName("other.lab")).verify(leaves["robot"], [])
    for role in ("commander", "observer"):
        with pytest.raises(VerificationError):
            builder.build_server_verifier(x509.DNSName("robot.lab")).verify(leaves[role], [])
        (usage,) = leaves[role].extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        assert usage == x509.ExtendedKeyUsageOID.CLIENT_AUTH


def test_existing_keys_are_replaced_only_when_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "link"
    assert make(out) == 0
    first = content(out)
    capsys.readouterr()
    assert make(out) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "--overwrite" in line
    assert content(out) == first
    assert make(out, "--overwrite") == 0
    second = content(out)
    assert second.keys() == first.keys()
    assert all(second[name] != first[name] for name in first)
    # Somebody else's file is in the way: it is not deleted, asked for or not.
    (out / "robot" / "notes.txt").write_text("mine")
    third = content(out)
    assert make(out, "--overwrite") == 2
    assert content(out) == third
    assert [path.name for path in tmp_path.iterdir()] == ["link"]


def test_nothing_is_left_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The disk fills up at each write in turn."""
    out = tmp_path / "link"
    assert make(out) == 0
    first = content(out)
    written = 0
    real = os.fsync
    for failing in range(12):
        written = 0

        def full(descriptor: int, failing: int = failing) -> None:
            nonlocal written
            written += 1
            if written > failing:
                raise OSError(28, "No space left on device")
            real(descriptor)

        monkeypatch.setattr(os, "fsync", full)
        capsys.readouterr()
        assert make(out, "--overwrite") == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "No space left" in line
        assert make(tmp_path / "new") == 2
        monkeypatch.setattr(os, "fsync", real)
        assert content(out) == first
        assert [path.name for path in tmp_path.iterdir()] == ["link"]
    assert make(out, "--overwrite") == 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--host", "tls/robot:7447"], "neither a host name nor an IP address"),
        (["--host", "robot", "--listen", "*"], "neither a host name nor an IP address"),
        (["--host", "robot", "--port", "0"], "port 0"),
        (["--host", "robot", "--days", "0"], "days is 0"),
        (["--host", "robot", "--days", "100000"], "days is 100000"),
    ],
)
def test_bad_input_is_one_line(
    tmp_path: Path, options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["certificates", "--out", str(tmp_path / "link"), *options]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line
    assert list(tmp_path.iterdir()) == []


def test_a_file_in_the_way_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert make(tmp_path / "file", "--overwrite") == 2
    assert make(tmp_path / "file" / "below") == 2
    first, second = capsys.readouterr().err.splitlines()
    assert "not a directory" in first
    assert "cannot write" in second


def test_without_the_library_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ours = ("skewmi.deploy.wire.certificates", "skewmi.deploy.wire.authority")
    for name in [n for n in sys.modules if n.startswith(ours)]:
        monkeypatch.delitem(sys.modules, name)
    real = builtins.__import__

    def without(name: str, *args, **kwargs):
        if name.split(".")[0] == "cryptography":
            raise ModuleNotFoundError(f"No module named {name!r}", name="cryptography")
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    assert make(tmp_path / "link") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "[security]" in line
    assert not (tmp_path / "link").exists()


def test_deploying_does_not_need_the_library() -> None:
    """A robot's machine runs from the files; nothing there makes certificates."""
    code = (
        "import sys, skewmi.cli.robot, skewmi.cli.deploy, skewmi.cli.stop;"
        "print([m for m in sys.modules if m.split('.')[0] == 'cryptography'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_rules_name_the_very_certificates(tmp_path: Path) -> None:
    assert make(tmp_path / "a") == 0
    assert make(tmp_path / "b") == 0
    names = {}
    for issue in ("a", "b"):
        for role in ROLES:
            (name,) = certificate(
                tmp_path / issue / role / "certificate.pem"
            ).subject.get_attributes_for_oid(x509.NameOID.COMMON_NAME)
            names[issue, role] = str(name.value)
    assert len(set(names.values())) == 6, "an earlier issue's names must mean nothing now"
    for issue in ("a", "b"):
        text = (tmp_path / issue / "robot" / "zenoh.json5").read_text()
        assert set(re.findall(r"skewmi-\w+-[0-9a-f]+", text)) == {
            names[issue, "commander"],
            names[issue, "observer"],
        }
