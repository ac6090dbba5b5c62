"""Worker pools of several devices: GPUs run concurrently and start before the CPU."""

import itertools
import threading
import time

from warpcontact.stepping import worker_pool


class Listed:
    """A device with a name; not hashable, like devices of Warp."""

    __hash__ = None

    def __init__(self, name):
        self.name, self.is_cuda, self.is_cpu = name, name != "cpu", name == "cpu"

    def __str__(self):
        return self.name


class Stepper:
    """Stand-in for the stepper of a slice that records which thread steps it."""

    def __init__(self, name, captured, log, meeting=None):
        self.device, self.captured, self.log, self.meeting = Listed(name), captured, log, meeting

    def select(self, own):
        pass

    def set_frame(self, number):
        pass

    def capture(self, chunks):
        pass

    def step(self, chunks):
        if self.meeting is not None:
            self.meeting.wait(timeout=10.0)  # BrokenBarrierError if the others are not stepped concurrently
        self.log.append((str(self.device), threading.current_thread() is threading.main_thread()))


def shares(names, *args, members=1):
    """One slice per device, with a stepper for each of its threads."""
    return [
        worker_pool.DeviceShare(
            [slice(0, 10**6)], [Stepper(name, *args) for _ in range(members if name == "cpu" else 1)]
        )
        for name in names
    ]


def test_gpus_with_host_decisions_are_launched_concurrently():
    log, meeting = [], threading.Barrier(3)
    parts = shares(("cuda:0", "cuda:1", "cpu"), False, log, meeting)
    assert list(worker_pool.WorkerPool(parts).step(8)) == [8]
    assert sorted(name for name, _ in log) == ["cpu", "cuda:0", "cuda:1"]


def test_slices_of_one_gpu_are_launched_sequentially():
    log = []
    made = worker_pool.WorkerPool(shares(("cuda:0", "cuda:1", "cuda:0"), False, log))
    list(made.step(8))
    assert made._threads == 2
    assert sorted(name for name, _ in log) == ["cuda:0", "cuda:0", "cuda:1"]


def test_graphs_are_launched_on_gpus_before_cpu_slices_start():
    log = []
    parts = shares(("cpu", "cuda:0", "cpu", "cuda:1"), True, log, members=2)
    list(worker_pool.WorkerPool(parts).step(32))
    assert log[:2] == [("cuda:0", True), ("cuda:1", True)]
    assert [name for name, _ in log[2:]] == ["cpu", "cpu"]
    assert not any(alone for _, alone in log[2:])


def chunks_of(slices, monkeypatch):
    """Steps of each work item, by slice, when two threads take 1000 steps."""
    begun, steps_of_items, lock = {}, {}, threading.Lock()

    class OnSlices(Stepper):
        def select(self, own):
            self.own = own.start

        def step(self, chunks):
            with lock:
                assert not begun.get(self.own), "somebody else is at it"
                begun[self.own] = True
            time.sleep(0.001)
            with lock:
                begun[self.own] = False
                steps_of_items.setdefault(self.own, []).append(sum(chunk.steps for chunk in chunks))

    made = worker_pool.WorkerPool(
        [
            worker_pool.DeviceShare(
                [slice(k, k + 1) for k in range(slices)], [OnSlices("cpu", True, []) for _ in range(2)]
            )
        ]
    )
    monkeypatch.setattr(worker_pool, "SERIAL_SECONDS", 0.0)
    assert list(made.step(8))[-1] == 8
    steps_of_items.clear()
    made._chunk_sizer.steps = 1000
    assert list(made.step(1000)) == [1000]
    assert {own: sum(counts) for own, counts in steps_of_items.items()} == dict.fromkeys(range(slices), 1000)
    return steps_of_items


def test_few_slices_are_split_into_chunks_of_decreasing_length(monkeypatch):
    """Other threads take the next item of a slice whose thread is slow. The last items are short."""
    for counts in chunks_of(3, monkeypatch).values():
        assert counts[0] > 500
        assert counts == sorted(counts, reverse=True)
        # Two threads with three slices of 1000 steps take 1500 steps each.
        assert counts[-1] <= worker_pool._LAST_ITEM_FRACTION * 1500
        assert all(count % worker_pool._MIN_STEPS == 0 for count in counts)


def test_only_the_last_of_many_slices_are_split_into_chunks(monkeypatch):
    """Moving a slice to another thread loads it into the cache again, so most slices are not split."""
    steps_of_items = chunks_of(14, monkeypatch)
    assert [len(steps_of_items[own]) for own in range(6)] == [1] * 6
    assert all(len(steps_of_items[own]) > 2 for own in range(6, 14))


def test_steps_without_duration_are_split_into_several_chunks(monkeypatch):
    """With frozen environments only: after a reset, a chunk of that many steps could not be interrupted."""
    monkeypatch.setattr(worker_pool, "_MAX_ENV_STEPS", 2**15)
    made = worker_pool.WorkerPool(
        [worker_pool.DeviceShare([slice(0, 64)], [Stepper("cpu", True, []) for _ in range(2)])]
    )
    done = [0, *made.step(10**5)]
    assert done[-1] == 10**5
    # Two threads share 64 items; the last one may be half as long again.
    assert 2**10 <= max(later - earlier for earlier, later in itertools.pairwise(done)) <= 1.5 * 2**10


def test_slow_steps_of_few_environments_use_all_threads():
    """Whether threads pay off follows from the measured duration of steps, not from the number of environments."""
    log = []

    class Slow(Stepper):
        def step(self, chunks):
            time.sleep(2 * worker_pool.SERIAL_SECONDS)
            super().step(chunks)

    share = worker_pool.DeviceShare(
        [slice(k, k + 1) for k in range(2)], [Slow("cpu", True, log) for _ in range(2)]
    )
    made = worker_pool.WorkerPool([share])
    list(made.step(8))
    assert [alone for _, alone in log] == [True, True]
    log.clear()
    list(made.step(8))
    assert [alone for _, alone in log] == [False, False]
    # Shorter steps do not.
    made._step_seconds = 0.0
    log.clear()
    list(made.step(8))
    assert [alone for _, alone in log] == [True, True]
