"""`panoloc keys`, which needs no running service."""

import errno
import json
import os
from pathlib import Path
from unittest.mock import Mock

import pytest

from panoloc.service.keys.key_ring import KeyRing
from tests.service.cli.commands import Panoloc


def test_a_key_is_made_shown_once_listed_and_revoked(panoloc: Panoloc, tmp_path: Path) -> None:
    folder = ("--data-dir", tmp_path)
    made = panoloc("keys", "make", "phones", "--scope", "localize", "--scope", "read", "--json", *folder)
    assert made.code == 0
    key = json.loads(made.out)
    assert key["scopes"] == ["localize", "read"]
    assert KeyRing("", tmp_path).find(key["key"]) is not None
    listed = panoloc("keys", "list", "--json", *folder)
    assert key["key"] not in listed.out
    assert json.loads(listed.out)["id"] == key["id"]
    assert panoloc("keys", "revoke", key["id"], *folder).code == 0
    assert KeyRing("", tmp_path).find(key["key"]) is None
    unknown = panoloc("keys", "revoke", "key_unknown", *folder)
    assert unknown.code == 1
    assert "panoloc keys list" in unknown.err
    changes = [json.loads(line)["change"] for line in (tmp_path / "audit.jsonl").read_text().splitlines()]
    assert changes == ["key made", "key revoked"]


def test_where_no_key_was_ever_made_the_folder_is_named_and_nothing_is_left_there(
    panoloc: Panoloc, tmp_path: Path
) -> None:
    folder = tmp_path / "elsewhere"
    listed, revoked = (panoloc("keys", *what, "--data-dir", folder) for what in (["list"], ["revoke", "key_typo"]))
    assert (listed.code, listed.out) == (2, "")
    assert "which does not exist; set --data-dir or PANOLOC_DATA_DIR" in listed.said
    assert (revoked.code, revoked.out) == (1, "")
    assert f"keys in {folder}" in revoked.err
    assert not folder.exists()
    folder.mkdir()
    empty = panoloc("keys", "list", "--data-dir", folder)
    assert (empty.code, empty.err) == (0, f"No keys in {folder}.\n")


def test_an_id_that_is_none_leaves_no_other_key_open(panoloc: Panoloc, tmp_path: Path) -> None:
    make = ("keys", "make", "phones", "--scope", "read", "--json", "--data-dir", tmp_path)
    first, second = (json.loads(panoloc(*make).out) for _ in range(2))
    ids = ("key_typo", first["id"], "key_other", second["id"], first["id"])
    done = panoloc("keys", "revoke", *ids, "--data-dir", tmp_path)
    assert done.code == 1
    assert done.out.splitlines() == [f"revoked {key['id']}" for key in (first, second)]
    ring = KeyRing("", tmp_path)
    assert [ring.find(key["key"]) for key in (first, second)] == [None, None]
    assert [line.partition(" is not revoked: ")[0] for line in done.err.splitlines()] == [
        "Error: key_typo",
        "Error: key_other",
    ]


def test_a_full_disk_is_said_and_keeps_the_keys_that_were_and_the_next_is_tried(
    panoloc: Panoloc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make = ("keys", "make", "phones", "--scope", "read", "--json", "--data-dir", tmp_path)
    first, second = (json.loads(panoloc(*make).out) for _ in range(2))
    before = (tmp_path / "keys.json").read_bytes()
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    monkeypatch.setattr(os, "fsync", Mock(side_effect=[full, full, None]))
    refused = panoloc(*make)
    assert (refused.code, str(tmp_path / "keys") in refused.err.replace("\n", "")) == (1, True)
    assert (tmp_path / "keys.json").read_bytes() == before
    assert not list(tmp_path.glob("*.part"))
    done = panoloc("keys", "revoke", first["id"], second["id"], "--data-dir", tmp_path)
    assert (done.code, done.out) == (1, f"revoked {second['id']}\n")
    assert f"{first['id']} is not revoked: [Errno {errno.ENOSPC}]" in done.err
    ring = KeyRing("", tmp_path)
    assert ring.find(first["key"]) is not None
    assert ring.find(second["key"]) is None


def test_a_scope_that_there_is_not_is_wrong_usage(panoloc: Panoloc, tmp_path: Path) -> None:
    refused = panoloc("keys", "make", "phones", "--scope", "everything", "--data-dir", tmp_path)
    assert refused.code == 2
    assert not (tmp_path / "keys.json").exists()


@pytest.mark.parametrize(
    "whose",
    [
        ("",),
        (" ",),
        ("a\x1b[31m",),
        ("a\nb",),
        ("phones", "--tenant", "*"),
        ("phones", "--tenant", ""),
        ("phones", "--tenant", "a\nb"),
    ],
)
def test_a_key_of_nobody_and_one_of_everybody_are_none(
    panoloc: Panoloc, tmp_path: Path, whose: tuple[str, ...]
) -> None:
    refused = panoloc("keys", "make", *whose, "--scope", "read", "--data-dir", tmp_path)
    assert refused.code == 1
    assert "expected" in refused.err
    assert not (tmp_path / "keys.json").exists()


def test_a_folder_that_no_service_has_used_is_named_as_such(panoloc: Panoloc, tmp_path: Path) -> None:
    new, used = tmp_path / "new", tmp_path / "used"
    (used / "maps").mkdir(parents=True)
    make = ("keys", "make", "phones", "--scope", "localize", "--data-dir")
    for _ in range(2):  # a key that is there does not make it one
        made = panoloc(*make, new)
        assert made.code == 0
        assert str(new) in made.err.replace("\n", "")
        assert "No service has used that folder yet" in made.err
    made = panoloc(*make, used)
    assert str(used) in made.err.replace("\n", "")
    assert "No service" not in made.err
    assert "panoloc maps share" not in made.err


def test_who_has_maps_already_is_told_that_a_new_key_does_not_see_them(panoloc: Panoloc, tmp_path: Path) -> None:
    (tmp_path / "maps" / "map_1a2b").mkdir(parents=True)
    make = ("keys", "make", "phones", "--data-dir", tmp_path, "--scope")
    assert "panoloc maps share" in panoloc(*make, "read").err.replace("\n", " ")
    assert "panoloc maps share" not in panoloc(*make, "admin").err.replace("\n", " ")
