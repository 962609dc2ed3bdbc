"""Experiments that need no data, in a module that worker processes can import."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from manip3d import Mesh, datasets
from manip3d.experiments import Case, Claim, Column, Experiment, Finding, Plan, Row

TRIANGLE = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])


def square(case: Case) -> Row:
    """Square a number; leave a line in a log, so that tests can count the runs."""
    number = case.options["number"]
    log = case.options.get("log")
    if log:
        with Path(log).open("a") as stream:
            stream.write(f"{number}\n")
    if case.options.get("fail") == number:
        raise ValueError(f"no square for {number} today")
    if case.options.get("die") == number:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(case.options.get("seconds", 0))
    noise = np.random.default_rng(case.options.get("seed", 0)).normal()
    return {
        "square": number**2,
        "noise": float(noise),
        "numpy": np.float64(number),
        "pair": (number, number),
        "simplified": TRIANGLE,
    }


def count_faces(case: Case) -> Row:
    return {"faces": datasets.load_mesh(case.inputs[0]).num_faces}


def experiment(
    *numbers: int, name: str = "toy", claims: Sequence[Claim] = (), **options
) -> Experiment:
    """An experiment that squares numbers."""

    def cases(plan: Plan) -> list[Case]:
        return [
            Case(
                square,
                {"model": f"n{n}", "method": "square", "number": n, "seed": plan.seed} | options,
            )
            for n in numbers
        ]

    return Experiment(
        id=name,
        title="Squares",
        published="",
        data=(),
        cases=cases,
        columns=(Column("model", "model"), Column("square", "square")),
        claims=tuple(claims),
    )


def all_below(limit: int) -> Claim:
    """Every square is below a limit."""

    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        for row in rows:
            yield Finding(row["model"], row["square"] < limit, f"{row['square']}")

    return Claim(f"every square is below {limit}", "aim", judge)
