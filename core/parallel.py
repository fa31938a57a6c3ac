"""Parts of a batch side by side on the cores of the processor.

The tensors of a query are small: most operations take some ten microseconds, too little for several threads to share. So threads
share candidates instead: each computes its part from beginning to end, with operations of one thread. A GPU takes the whole
batch at once.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import torch

Part = TypeVar("Part")
Result = TypeVar("Result")


class Lanes:
    """`count` lanes; with one, everything happens in the caller's thread. Any number of queries may share them."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._threads: ThreadPoolExecutor | None = None

    @staticmethod
    def of_device(device: torch.device) -> "Lanes":
        """Return as many lanes as PyTorch has threads on a processor, one on a GPU."""
        return Lanes(torch.get_num_threads() if device.type == "cpu" else 1)

    def map(self, work: Callable[[Part], Result], parts: Sequence[Part]) -> list[Result]:
        """Return what `work` returns for each part, in their order; raises what it raises. `work` must not call this itself."""
        if self.count == 1 or len(parts) < 2:
            return [work(part) for part in parts]
        if self._threads is None:
            # Each thread has its own number of threads for operations.
            self._threads = ThreadPoolExecutor(self.count, "lane", initializer=torch.set_num_threads, initargs=(1,))
        inference = torch.is_inference_mode_enabled()

        def work_as_the_caller_would(part: Part) -> Result:
            with torch.inference_mode(inference):  # the mode belongs to a thread
                return work(part)

        return list(self._threads.map(work_as_the_caller_would, parts))

    def shares(self, count: int) -> list[slice]:
        """Return slices that deal `count` things, the first of which may be costlier, evenly to the lanes."""
        lanes = max(1, min(self.count, count))
        return [slice(lane, None, lanes) for lane in range(lanes)]
