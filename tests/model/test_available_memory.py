"""Available memory as reported by the system and its control groups."""

from types import SimpleNamespace

import psutil
import pytest

from warpcontact.system import resources
from warpcontact.system.resources import HOST

LIMITED = {"memory.max": "1000000", "memory.current": "700000", "memory.stat": "anon 1\ninactive_file 100000\n"}


OLD = {
    "memory.limit_in_bytes": "1000000",
    "memory.usage_in_bytes": "700000",
    "memory.stat": "cache 1\ntotal_inactive_file 100000\n",
}


@pytest.mark.parametrize(
    ("cgroup", "folder", "files"),
    [
        ("0::/user/job\n", "user/job", LIMITED),
        ("0::/user/job/step\n", "user", LIMITED),  # the limit is in a parent group
        ("0::/docker/1234\n", ".", LIMITED),  # in a container the group is the root
        ("5:cpu:/x\n3:memory,pids:/job\n", "memory/job", OLD),
    ],
)
def test_available_memory_includes_control_group_limits(cgroup, folder, files, tmp_path, monkeypatch):
    (tmp_path / "cgroup").write_text(cgroup)
    top = tmp_path / "sys"
    (top / folder).mkdir(parents=True)
    for name, text in files.items():
        (top / folder / name).write_text(text)
    monkeypatch.setattr(resources, "_CGROUP", tmp_path / "cgroup")
    monkeypatch.setattr(resources, "_CGROUPS", top)
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=4000 * 1024))
    assert resources.available_memory(HOST).size == 400_000
    limit = "memory.max" if "memory.max" in files else "memory.limit_in_bytes"
    (top / folder / limit).write_text("max\n")
    assert resources.available_memory(HOST).size == 4000 * 1024


def test_available_memory_without_control_groups_is_that_of_the_machine(tmp_path, monkeypatch):
    monkeypatch.setattr(resources, "_CGROUP", tmp_path / "none")
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=4_096_000))
    assert resources.available_memory(HOST).size == 4_096_000
