"""Exceptions: a class a code, four parts, and nothing lost on the way to another process."""

from __future__ import annotations

import pickle

import pytest

import trex
from trex import _trex, errors


def test_each_code_of_the_library_has_its_class():
    assert sorted(errors.BY_CODE) == sorted(_trex.error_codes())
    assert len(errors.BY_CODE) == len(set(errors.BY_CODE.values())) == len(_trex.error_codes())


@pytest.mark.parametrize("kind", errors.BY_CODE.values())
def test_four_parts_are_attributes_and_survive_a_pickle(kind):
    made = kind("what", "where", "numbers", "next", 7)
    back = pickle.loads(pickle.dumps(made))
    for error in (made, back):
        assert (error.what, error.where, error.numbers, error.next_step) == ("what", "where", "numbers", "next")
        assert error.smallest_limit_bytes == 7 and isinstance(error, trex.TrexError)
        assert str(error) == f"what [{kind.code}]\n  where: where\n  numbers: numbers\n  next: next"


def test_a_limit_that_is_too_small_is_refused_with_one_that_works(surface_file):
    limit, refusals = 25 << 20, 0
    while True:
        try:
            with trex.open(surface_file, memory_limit=limit, threads=1) as model:
                model.intersect([0, 0, 0], [0, 0, 1])
            break
        except errors.MemoryLimitError as refused:
            assert isinstance(refused, MemoryError) and refused.smallest_limit_bytes > limit
            limit, refusals = refused.smallest_limit_bytes, refusals + 1
    assert refusals == 1


def test_files_that_are_none_are_told_apart(tmp_path):
    with pytest.raises(errors.InputUnreadableError):
        trex.open(tmp_path / "none.trex")
    (tmp_path / "text.trex").write_text("no page file" * 1000)
    with pytest.raises(errors.InputFormatError) as refused:
        trex.open(tmp_path / "text.trex")
    assert "text.trex" in refused.value.where and refused.value.next_step
    (tmp_path / "empty.obj").write_text("v 0 0 0\n")
    with pytest.raises(errors.InputEmptyError):
        trex.build(tmp_path / "empty.obj", tmp_path / "out.trex")


def test_names_of_files_do_not_reach_the_terminal_as_commands(tmp_path):
    with pytest.raises(errors.InputUnreadableError) as refused:
        trex.open(tmp_path / "a\x1b[2Jb.trex")
    assert "\x1b" not in str(refused.value) and "\x1b" in refused.value.where
