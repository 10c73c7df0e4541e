"""The self-test's reading of Unity's output, and what it makes of executables that misbehave."""

from __future__ import annotations

from pathlib import Path

import pytest

from tailbeat.core import selftest
from tailbeat.core.files import plain
from tailbeat.core.selftest import SelftestError, SelftestReport, SelftestResult

OUTPUT = """\
/x/tests/unit/test_gait.c:12:test_starts_at_zero:PASS
/x/tests/unit/test_gait.c:20:test_slew:FAIL: Expected 1 Was 2
noise that a test printed
/x/tests/unit/test_gait.c:31:test_later:IGNORE: needs hardware

-----------------------
3 Tests 1 Failures 1 Ignored
FAIL
"""


def script(folder: Path, body: str) -> Path:
    path = folder / "test_thing"
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(0o755)
    return path


def unity(lines: str, summary: str) -> str:
    return f"cat <<'END'\n{lines}\n{summary}\nEND"


def test_parses_all_verdicts() -> None:
    assert selftest.parse_unity("test_gait", OUTPUT) == [
        SelftestResult("test_starts_at_zero", "test_gait", True),
        SelftestResult("test_slew", "test_gait", False, "Expected 1 Was 2"),
        SelftestResult("test_later", "test_gait", True, "needs hardware"),
    ]


@pytest.mark.parametrize("text", ["", "PASS", "a:b:c:PASS", "x.c:1:test:PASSED", "::::", "\0:1:t:"])
def test_other_lines_are_no_tests(text: str) -> None:
    assert selftest.parse_unity("suite", text) == []


def test_a_good_suite(tmp_path: Path) -> None:
    body = unity("a.c:1:test_one:PASS", "1 Tests 0 Failures 0 Ignored")
    assert selftest.run_suite(script(tmp_path, body)) == [
        SelftestResult("test_one", "test_thing", True)
    ]


def test_a_failure_counts_once(tmp_path: Path) -> None:
    body = unity("a.c:1:test_one:FAIL: no", "1 Tests 1 Failures 0 Ignored") + "\nexit 1"
    assert [test.ok for test in selftest.run_suite(script(tmp_path, body))] == [False]


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("kill -SEGV $$", "signal 11"),
        ("exit 3", "exit status 3"),
        ("true", "no output"),
        ("echo a.c:1:test_one:PASS; kill -ABRT $$", "signal 6"),
        ("echo a.c:1:test_one:PASS", "exit status 0"),
        (
            unity("a.c:1:t:PASS", "1 Tests 0 Failures 0 Ignored")
            + "\necho '==1==ERROR: LeakSanitizer: leaks' >&2; exit 23",
            "LeakSanitizer",
        ),
    ],
)
def test_a_crash_is_a_failed_test(tmp_path: Path, body: str, message: str) -> None:
    last = selftest.run_suite(script(tmp_path, body))[-1]
    assert (last.name, last.suite, last.ok) == ("test_thing", "test_thing", False)
    assert message in last.message


def test_a_missing_executable_is_a_failed_test(tmp_path: Path) -> None:
    (result,) = selftest.run_suite(tmp_path / "test_gone")
    assert not result.ok and "cannot be started" in result.message


def test_a_hang_is_a_failed_test(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(selftest, "TEST_TIMEOUT_S", 0.0)
    (result,) = selftest.run_suite(script(tmp_path, "exec sleep 60"))
    assert not result.ok and "still running" in result.message


def test_report_counts() -> None:
    report = SelftestReport(selftest.parse_unity("test_gait", OUTPUT))
    document = plain(report.as_dict())
    assert (document["passed"], document["failed"]) == (2, 1)
    tests = document["tests"]
    assert isinstance(tests, list) and set(tests[0]) == {"name", "suite", "ok", "message"}


def test_the_clone_that_runs_this_is_the_source() -> None:
    assert selftest.find_source() == Path(__file__).parents[3]


_MANY = """case "$1" in
'') echo test_one; echo test_two;;
*) echo "a.c:1:$1_works:PASS"; echo "1 Tests 0 Failures 0 Ignored";;
esac"""


def test_without_a_clone_the_packaged_programs_are_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(selftest, "checkout", lambda: None)
    for stem in ("tailbeat_selftest_mock", "tailbeat_selftest_sim"):
        script(tmp_path, _MANY).rename(tmp_path / stem)
    suites = selftest.packaged_suites(tmp_path)
    assert [suite for _, suite in suites] == ["test_one", "test_two"] * 2
    monkeypatch.setattr(selftest, "packaged_suites", lambda: suites)
    steps: list[tuple[float, str]] = []
    report = selftest.run_selftest(on_suite=lambda *step: steps.append(step))
    assert (report.passed, report.failed) == (4, 0)
    assert steps[1] == (0.25, "test_two")


def test_a_package_without_the_programs_is_explained(tmp_path: Path) -> None:
    with pytest.raises(SelftestError, match=r"does not start.*again"):
        selftest.packaged_suites(tmp_path)


def test_no_tree_is_explained(tmp_path: Path) -> None:
    with pytest.raises(SelftestError, match="tests/unit"):
        selftest.run_selftest(tmp_path)


def test_missing_tool_is_explained() -> None:
    with pytest.raises(SelftestError, match="apt-get install"):
        selftest.build_step(["no-such-tool-anywhere"])


def test_failed_build_names_the_error() -> None:
    with pytest.raises(SelftestError, match=r"do not build: a\.c:1: error: oops"):
        selftest.build_step(["sh", "-c", "echo hm; echo 'a.c:1: error: oops'; exit 1"])
