"""Pages of the documentation: links, paths and names of the code exist."""

from __future__ import annotations

import pkgutil
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted([ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").rglob("*.md")])
PACKAGES = ("api", "bench", "docs", "estimation", "fleet_db", "ingest", "tests")


def relative(page: Path) -> str:
    """Return a page's path inside the repository, for the names of tests."""
    return page.relative_to(ROOT).as_posix()


@pytest.fixture(scope="module")
def files() -> frozenset[str]:
    """Return the paths of all files of the repository."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()
    return frozenset(path for path in listed if (ROOT / path).exists())


@pytest.mark.parametrize("page", PAGES, ids=relative)
def test_links_lead_to_files_and_headings(page: Path) -> None:
    broken = []
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        path, _, anchor = target.partition("#")
        if re.match(r"\w+:", target):
            continue
        linked = (page.parent / path).resolve() if path else page
        if not linked.exists() or (anchor and anchor not in anchors(linked)):
            broken.append(target)
    assert broken == []


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as code hosts make them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=relative)
def test_paths_in_the_text_exist(page: Path, files: frozenset[str]) -> None:
    folders = {"/".join(parts[:n]) for parts in (path.split("/") for path in files) for n in range(1, len(parts))}
    names = {"/".join(parts[n:]) for parts in (path.split("/") for path in files) for n in range(len(parts))}
    missing = []
    for quoted in re.findall(r"`([^`\n]+)`", page.read_text()):
        if re.fullmatch(r"[\w./-]+\.(py|js)", quoted):
            missing += [] if quoted in names else [quoted]
        elif re.fullmatch(rf"(?:{'|'.join(PACKAGES)})/[a-z\d_./-]*", quoted):
            missing += [] if quoted.rstrip("/") in files | folders else [quoted]
        elif re.fullmatch(r"python -m bench\.\w+.*", quoted):
            missing += [] if f"bench/{quoted.split()[2].removeprefix('bench.')}.py" in files else [quoted]
    assert missing == []


@pytest.mark.parametrize("page", PAGES, ids=relative)
def test_names_of_the_code_exist(page: Path) -> None:
    quoted = set(re.findall(r"`((?:estimation|ingest|api|fleet_db)(?:\.\w+)+)`", page.read_text()))
    for name in quoted:
        pkgutil.resolve_name(name)
