"""Tasks for executors, where worker processes can import them."""

import os
import signal
import time
from pathlib import Path


def square(number: int) -> int:
    return number * number


def where(_: int) -> tuple[int, int]:
    """Process and its threads of BLAS."""
    import numpy as np
    from threadpoolctl import threadpool_info

    _ = np.ones((4, 4)) @ np.ones((4, 4))
    time.sleep(0.1)
    return os.getpid(), max((i["num_threads"] for i in threadpool_info()), default=1)


def die_once(folder: str) -> str:
    """Killed, as by a lack of memory, the first time it is tried."""
    mark = Path(folder) / "died"
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "survived"


def die_always(text: str) -> str:
    if text == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    return text


def fail(number: int) -> int:
    if number == 2:
        raise ValueError("two")
    return number


def until_stopped(folder: str) -> str:
    """Ends when a file appears, as a specimen ends when its study is stopped."""
    (Path(folder) / f"started-{os.getpid()}").touch()
    while not (Path(folder) / "stop").exists():
        time.sleep(0.02)
    return "ended"
