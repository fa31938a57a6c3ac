"""Keys that `panoloc keys` makes and revokes, and the service's ring of them. No network."""

import json
import os
import stat
import threading
from pathlib import Path

import pytest

from panoloc.service.keys.audit_log import AuditLog
from panoloc.service.keys.caller import ALL_SCOPES
from panoloc.service.keys.key_file import KeyFile, KeyFileError
from panoloc.service.keys.key_ring import KeyRing


def ring(folder: Path, setting: str = "") -> KeyRing:
    return KeyRing(setting, folder, look_s=0.0)


def test_a_key_that_was_made_opens_what_it_was_made_for_and_is_not_in_the_file(tmp_path: Path) -> None:
    keys = ring(tmp_path)
    assert not keys.required
    made, text = KeyFile(tmp_path).make("phones", ["localize"], tenant="museum")
    assert keys.required
    caller = keys.find(text)
    assert caller is not None
    assert (caller.id, caller.scopes, caller.tenant) == (f"key {made.id}", {"localize"}, "museum")
    assert keys.find(text[:-1]) is None
    assert text not in (tmp_path / "keys.json").read_text()
    assert stat.S_IMODE((tmp_path / "keys.json").stat().st_mode) == 0o600


def test_a_data_folder_that_is_made_for_a_key_is_for_its_user_alone(tmp_path: Path) -> None:
    KeyFile(tmp_path / "data").make("phones", ["localize"])
    assert stat.S_IMODE((tmp_path / "data").stat().st_mode) == 0o700


def test_a_key_without_a_tenant_has_one_of_its_own_and_an_administrator_sees_all(tmp_path: Path) -> None:
    file, keys = KeyFile(tmp_path), ring(tmp_path)
    (_, first), (_, second), (_, admin) = (
        file.make("a", ["read"]),
        file.make("b", ["read"]),
        file.make("c", ["admin"]),
    )
    found = [keys.find(text) for text in (first, second, admin)]
    assert len({caller.tenant for caller in found if caller}) == 3
    assert found[2] is not None
    assert (found[2].tenant, found[2].scopes) == (None, ALL_SCOPES)


def test_a_revoked_key_opens_nothing_and_the_last_one_does_not_open_the_service(tmp_path: Path) -> None:
    file, keys = KeyFile(tmp_path), ring(tmp_path)
    made, text = file.make("phones", ["read"])
    assert keys.find(text) is not None
    assert file.revoke(made.id).revoked_at is not None
    assert keys.find(text) is None
    assert keys.required
    with pytest.raises(KeyFileError, match="panoloc keys list"):
        file.revoke("key_unknown")


@pytest.mark.parametrize("damage", ["", "{", '{"keys": [{"id": "key_1"}]}', "[]"])
def test_a_file_that_is_damaged_or_gone_opens_nothing(tmp_path: Path, damage: str) -> None:
    keys = ring(tmp_path, "from-the-setting")
    _, text = KeyFile(tmp_path).make("phones", ["read"])
    assert keys.find(text) is not None
    (tmp_path / "keys.json").write_text(damage)
    assert keys.find(text) is None
    (tmp_path / "keys.json").unlink()
    assert keys.find(text) is None
    assert keys.required
    assert keys.find("from-the-setting") is not None


def test_a_key_file_that_was_taken_away_is_told_from_one_that_never_was(tmp_path: Path) -> None:
    assert not ring(tmp_path).file.is_lost
    KeyFile(tmp_path).make("phones", ["read"])
    assert not ring(tmp_path).file.is_lost
    (tmp_path / "keys.json").unlink()
    assert ring(tmp_path).file.is_lost


def test_keys_that_are_made_at_the_same_time_are_all_kept(tmp_path: Path) -> None:
    makers = [
        threading.Thread(target=lambda name=str(number): KeyFile(tmp_path).make(name, ["read"])) for number in range(8)
    ]
    for maker in makers:
        maker.start()
    for maker in makers:
        maker.join()
    assert {key.name for key in KeyFile(tmp_path).read()} == {str(number) for number in range(8)}


def test_the_audit_log_is_appended_to_and_costs_no_change_where_it_cannot_be_written(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    log = AuditLog(tmp_path)
    log.note("key key_1", "map registered", "map_1", "req_1")
    AuditLog(tmp_path).note("user root", "key revoked", "key_1")
    first, second = (json.loads(line) for line in log.path.read_text().splitlines())
    assert (first["who"], first["change"], first["what"], first["request_id"]) == (
        "key key_1",
        "map registered",
        "map_1",
        "req_1",
    )
    assert second["at"] >= first["at"]
    os.remove(log.path)
    log.path.mkdir()
    log.note("key key_1", "map deleted", "map_1", "req_2")
    assert "cannot be written" in caplog.text


def test_a_file_that_was_taken_away_is_told_from_one_that_was_never_made(tmp_path: Path) -> None:
    file = KeyFile(tmp_path)
    assert not file.is_lost
    file.make("phones", ["localize"])
    assert not file.is_lost
    file.path.unlink()
    assert file.is_lost
