"""The numerics know the database by the names of its types alone."""

import subprocess
import sys
from pathlib import Path

import estimation


def test_the_jobs_run_without_the_database_being_imported() -> None:
    program = "import sys, estimation.jobs.catalogue\nassert not {'fleet_db', 'sqlalchemy'} & sys.modules.keys()"
    subprocess.run([sys.executable, "-c", program], check=True)


def test_one_module_names_the_types_of_the_database() -> None:
    files = Path(estimation.__file__).parent.rglob("*.py")
    assert [file.name for file in files if "from fleet_db" in file.read_text(encoding="utf-8")] == ["storage.py"]
