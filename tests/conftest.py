"""What the tests share: runs that are sampled once a test session, by whichever worker is first."""

import os
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import quick_posteriors
import reported
import shared

LONG = (
    "test_studies", "test_moves", "test_population", "test_figures", "test_sampler",
    "test_identifiability", "test_pages", "test_posterior", "test_fit", "test_design", "test_batch",
    "test_python_verbs", "test_plot_command", "test_profile", "test_resume", "test_compare",
    "test_evidence", "test_calibration", "test_check", "test_hierarchy", "test_processes",
)  # fmt: skip
"""Files that take longest, the longest first: the workers end together if they begin with them."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long files first; ``scripts/test.sh`` has xdist hand files out in this order."""
    rank = {name: i for i, name in enumerate(LONG)}
    items.sort(key=lambda item: rank.get(item.path.stem, len(LONG)))


@pytest.fixture(scope="session", autouse=True)
def session_folder(tmp_path_factory):
    """The folder that all workers of this session share."""
    own = tmp_path_factory.getbasetemp()
    # pytest-xdist gives each worker a folder of its own inside that of the session
    shared.use(own.parent if os.environ.get("PYTEST_XDIST_WORKER") else own)


@pytest.fixture
def copied(tmp_path) -> Callable[[Path], Path]:
    """A copy of a shared run folder, for a test that writes into it."""
    return lambda run: Path(shutil.copytree(run, tmp_path / f"copy-of-{run.name}"))


@pytest.fixture
def usual_signals() -> Iterator[None]:
    """Signals as a terminal gives them, though ``nohup`` or a background job ignores some.

    What is ignored would be so in every process that a test starts.
    """
    usual = {
        signal.SIGINT: signal.default_int_handler,
        signal.SIGTERM: signal.SIG_DFL,
        signal.SIGHUP: signal.SIG_DFL,
    }
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(scope="session")
def media_run(session_folder):
    """The shipped media with default options, all its files: not to be written into."""
    import biaxbayes

    data = Path(__file__).resolve().parents[1] / "data" / "donor2-media.csv"
    return biaxbayes.open_run(
        shared.made_once(
            "media.run",
            lambda folder: biaxbayes.sample(data, out=folder, seed=11, ess=800, workers=1),
        )
    )


@pytest.fixture(scope="session")
def small_run(session_folder):
    """Three ratios, exact mounting forces, kappa fixed, no figures: not to be written into."""
    import biaxbayes

    def sample(folder: Path) -> None:
        with quick_posteriors.runs_without_figures():
            data = quick_posteriors.small_specimen()
            biaxbayes.sample(data, out=folder, **quick_posteriors.QUICK)

    return biaxbayes.open_run(shared.made_once("small", sample))


@pytest.fixture
def small_copy(small_run, copied):
    """A copy of that run, for a test that writes into it."""
    import biaxbayes

    return biaxbayes.open_run(copied(small_run.path))


@pytest.fixture(scope="session")
def hostile_run(session_folder):
    """A run whose names try to break the report: not to be written into."""
    import biaxbayes

    return biaxbayes.open_run(shared.made_once("hostile", reported.hostile_run))


@pytest.fixture(scope="session")
def study(session_folder):
    """A finished study of four specimens of two donors in two groups: not to be written into."""
    from made_population import made_study

    return shared.made_once("population-study", made_study) / "study"


@pytest.fixture(scope="session")
def population(study):
    """The population of that study: not to be written into."""
    from made_population import made_population

    return made_population(study)


@pytest.fixture(scope="module")
def scheduler():
    """Address of a scheduler with two workers."""
    with shared.local_cluster(2) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(scope="module")
def chromium():
    import browser

    yield from browser.running_chromium()
