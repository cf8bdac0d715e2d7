"""The processes that torchrun starts for one training: each its own batch, one network, by the mean of gradients."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from ..lhm.base.errors import InputError
from .learning import torch


@dataclass(frozen=True)
class Processes:
    """The number of this process among `count`, and the device that it works on."""

    number: int
    count: int
    device: torch.device

    @property
    def first(self) -> bool:
        """Whether this is the one that writes and speaks."""
        return self.number == 0

    def average(self, parameters: Iterable[torch.nn.Parameter]) -> None:
        """Give every process the mean of all gradients."""
        if self.count == 1:
            return
        gradients = [value.grad for value in parameters if value.grad is not None]
        flat = torch.cat([gradient.flatten() for gradient in gradients])
        torch.distributed.all_reduce(flat)
        begin = 0
        for gradient in gradients:
            gradient.copy_(flat[begin : begin + gradient.numel()].view_as(gradient) / self.count)
            begin += gradient.numel()

    def wait(self) -> None:
        """Until all are here."""
        if self.count > 1:
            torch.distributed.barrier()


ALONE = Processes(0, 1, torch.device("cpu"))


@contextmanager
def processes(device: str) -> Iterator[Processes]:
    """Those of torchrun, or this one alone; of several each has its own "cuda" device.

    Raises InputError for a device that is not there.
    """
    number, count = int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1"))
    if count > 1 and device == "cuda":
        device = f"cuda:{os.environ.get('LOCAL_RANK', number)}"
    try:
        found = torch.device(device)
        torch.zeros(1, device=found)
    except (RuntimeError, AssertionError) as error:
        said = str(error).splitlines()[0][:80]
        raise InputError(f"training: no device {device!r} ({said})") from None
    if count == 1:
        yield Processes(0, 1, found)
        return
    torch.distributed.init_process_group("nccl" if found.type == "cuda" else "gloo")
    try:
        yield Processes(number, count, found)
    finally:
        torch.distributed.destroy_process_group()
