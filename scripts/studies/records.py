"""Records of studies: one JSON line each, kept as they end, gone on with where they stopped."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

__all__ = ["kept", "run_all"]

Study = Callable[[int], dict[str, Any]]


def kept(path: Path) -> list[dict[str, Any]]:
    """Records of a file in the order of their seeds; a line that was cut short is left out."""
    found: dict[int, dict[str, Any]] = {}
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    for line in lines:
        try:
            record = json.loads(line)
        except ValueError:
            continue
        found[record["seed"]] = record
    return [found[seed] for seed in sorted(found)]


def run_all(study: Study, seeds: Sequence[int], path: Path, workers: int) -> None:
    """Do the studies that have no record yet."""
    path.parent.mkdir(parents=True, exist_ok=True)
    done = {record["seed"] for record in kept(path)}
    left = [seed for seed in seeds if seed not in done]
    if path.exists() and not path.read_text(encoding="utf-8").endswith("\n"):
        with path.open("a", encoding="utf-8") as file:
            file.write("\n")

    def keep(record: dict[str, Any]) -> None:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(record) + "\n")
        told = {k: record[k] for k in ("seed", "state", "ess", "cpu") if k in record}
        print(path.stem, *(f"{k} {v}" for k, v in told.items()), flush=True)

    if workers == 1:
        for seed in left:
            keep(study(seed))
        return
    with ProcessPoolExecutor(workers) as pool:
        futures: list[Future[dict[str, Any]]] = [pool.submit(study, seed) for seed in left]
        for future in as_completed(futures):
            keep(future.result())
