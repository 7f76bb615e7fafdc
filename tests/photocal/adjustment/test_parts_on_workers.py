"""A block in parts on several processes and on a cluster, one of them killed on the way."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from photocal.adjustment.adjust import adjust
from photocal.adjustment.parts.adjusting import adjust_parts, solution_of_parts
from photocal.adjustment.parts.portions import write_parts
from photocal.adjustment.solver import Iteration
from photocal.base.workers import Cluster
from tests.photocal.adjustment.test_parts import BLOCKS, assert_same, in_parts

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")


def test_two_processes_find_what_one_does(tmp_path: Path) -> None:
    network = BLOCKS["free"].network()
    one, two = in_parts(network, tmp_path, 16), in_parts(network, tmp_path, 16, 2)
    assert one.chi_squared == two.chi_squared
    assert np.array_equal(one.point_covariance, two.point_covariance)


def test_two_workers_of_a_cluster_one_killed_between_two_steps(two_workers: Any, tmp_path: Path) -> None:
    distributed: Any = pytest.importorskip("distributed")
    network = BLOCKS["antenna with lever arm, three cameras"].network()
    killed = list[int]()
    with distributed.Client(two_workers.scheduler_address, set_as_default=False) as client:

        def report(step: Iteration) -> None:
            if step.number == 2:
                killed.append(next(iter(client.run(os.getpid).values())))
                os.kill(killed[0], signal.SIGKILL)

        dissection = write_parts(network, 16, tmp_path)
        adjusted = adjust_parts(tmp_path, dissection, Cluster(two_workers.scheduler_address), report)
    assert killed
    found = solution_of_parts(tmp_path, adjusted, len(dissection.parts))
    assert_same(found, adjust(network), network.rays.sigma)
