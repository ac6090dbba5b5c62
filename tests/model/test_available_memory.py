"""Available memory as reported by the system and its control groups."""

import os

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
    (tmp_path / "meminfo").write_text("MemTotal: 8000 kB\nMemAvailable: 4000 kB\n")
    top = tmp_path / "sys"
    (top / folder).mkdir(parents=True)
    for name, text in files.items():
        (top / folder / name).write_text(text)
    monkeypatch.setattr(resources, "_CGROUP", tmp_path / "cgroup")
    monkeypatch.setattr(resources, "_CGROUPS", top)
    monkeypatch.setattr(resources, "_MEMINFO", tmp_path / "meminfo")
    assert resources.available_memory(HOST).size == 400_000
    limit = "memory.max" if "memory.max" in files else "memory.limit_in_bytes"
    (top / folder / limit).write_text("max\n")
    assert resources.available_memory(HOST).size == 4000 * 1024


def test_available_memory_on_other_systems_is_found_or_unknown(tmp_path, monkeypatch):
    for name in ("_CGROUP", "_MEMINFO"):
        monkeypatch.setattr(resources, name, tmp_path / "none")
    system_values = {"SC_PHYS_PAGES": 1000, "SC_PAGE_SIZE": 4096, "SC_AVPHYS_PAGES": -1}
    monkeypatch.setattr(os, "sysconf", system_values.__getitem__, raising=False)
    assert resources.available_memory(HOST).size == 4_096_000
    monkeypatch.delattr(os, "sysconf")
    assert resources.available_memory(HOST) is None
