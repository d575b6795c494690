"""Hostile priors files with the words that their message must hold."""

from __future__ import annotations

REFUSED: dict[str, tuple[str | bytes, tuple[str, ...]]] = {
    "empty": ("", ("is empty; write what it should state",)),
    "binary": (b"\x00\x01\x02kappa = 0\n", ("is binary",)),
    "latin-1": ("# für uns\nkappa = 0\n".encode("latin-1"), ("is not UTF-8", "row 1")),
    "utf-16": ("kappa = 0\n".encode("utf-16"), ("is UTF-16",)),
    "gzip": (b"\x1f\x8b\x08\x00kappa", ("is a gzip archive",)),
    "not-toml": ("kappa: 0\n", ("not valid TOML",)),
    "python": ("__import__('os').system('touch owned')\n", ("not valid TOML",)),
    "twice": ("kappa = 0\nkappa = 0.1\n", ("not valid TOML",)),
    "deep": ("kappa = " + "[" * 3000 + "]" * 3000 + "\n", ("not valid TOML", "nested too deeply")),
    "unknown": ("stiffness = 3\n", ("unknown parameter 'stiffness'", "parameters are C1")),
    "long-name": ("a" * 5000 + " = 3\n", ("unknown parameter", "parameters are C1")),
    "escape-in-name": ('"k\\u001b[31mappa" = 3\n', ("unknown parameter",)),
    "path-as-name": ('"../../etc/passwd" = 3\n', ("unknown parameter",)),
    "nan": ("kappa = nan\n", ("kappa cannot be fixed at nan",)),
    "infinite": ("C1 = inf\n", ("C1 cannot be fixed at inf",)),
    "negative": ("C1 = -1\n", ("C1 cannot be fixed at -1", "above zero")),
    "zero-C1": ("C1 = 0\n", ("C1 cannot be fixed at 0",)),
    "kappa-too-large": ("kappa = 0.4\n", ("kappa cannot be fixed at 0.4", "0.333333")),
    "alpha-in-gradians": ("alpha = 100\n", ("alpha cannot be fixed at 100", "0 to 90")),
    "huge-integer": ("C1 = " + "9" * 400 + "\n", ("C1",)),
    "huger-integer": ("C1 = " + "9" * 9000 + "\n", ("not valid TOML",)),
    "boolean": ("kappa = true\n", ("kappa must be a number, a tie or a distribution",)),
    "date": ("kappa = 2024-01-01\n", ("kappa must be a number",)),
    "list": ("kappa = [0, 1]\n", ("kappa must be a number",)),
    "fixed-stretch": ("mounting_stretch = 1.0\n", ("cannot be fixed", "fix one of")),
    "tie-to-itself": ('k1 = "2 * k1"\n', ("k1 cannot be tied to",)),
    "tie-in-a-circle": ('k1 = "2 * C1"\nC1 = "2 * k1"\n', ("tied in a circle",)),
    "tie-negative": ('k1 = "-2 * C1"\n', ("k1 cannot be tied to",)),
    "tie-is-code": ("k1 = \"__import__('os').getpid() * C1\"\n", ("k1 cannot be tied to",)),
    "tie-unknown": ('k1 = "kappa"\n', ("k1 cannot be tied to",)),
    "tie-nan": ('k1 = "nan * C1"\n', ("k1 cannot be tied to",)),
    "no-family": ("k1 = { mean = 3 }\n", ("k1: unknown distribution",)),
    "unknown-family": (
        'k1 = { distribution = "cauchy", mean = 3 }\n',
        ("k1: unknown distribution 'cauchy'", "use one of normal"),
    ),
    "family-is-a-list": ("k1 = { distribution = [1] }\n", ("k1: unknown distribution",)),
    "missing-sd": ('alpha = { distribution = "normal", mean = 3 }\n', ("alpha", "lacks sd")),
    "extra-key": (
        'alpha = { distribution = "normal", mean = 3, sd = 1, mode = 2 }\n',
        ("alpha: a normal prior has no 'mode'",),
    ),
    "zero-sd": (
        'alpha = { distribution = "normal", mean = 3, sd = 0 }\n',
        ("alpha: the standard deviation must be positive",),
    ),
    "sd-is-text": (
        'alpha = { distribution = "normal", mean = 3, sd = "5" }\n',
        ("alpha: sd must be a finite number",),
    ),
    "sd-infinite": (
        'alpha = { distribution = "normal", mean = 3, sd = inf }\n',
        ("alpha: sd must be a finite number",),
    ),
    "huge-number": (
        'C1 = { distribution = "lognormal", median = ' + "9" * 400 + ", sd_log = 1 }\n",
        ("C1: median must be a finite number",),
    ),
    "backwards": (
        'kappa = { distribution = "uniform", low = 0.3, high = 0.1 }\n',
        ("kappa: low must be below high",),
    ),
    "outside": (
        'kappa = { distribution = "uniform", low = 0.5, high = 0.9 }\n',
        ("kappa: low must be below high",),
    ),
    "no-mass": (
        'alpha = { distribution = "normal", mean = 5000, sd = 1 }\n',
        ("alpha: the prior has no mass",),
    ),
    "no-mass-positive": (
        'C1 = { distribution = "normal", mean = -100, sd = 1 }\n',
        ("C1: the prior has no mass",),
    ),
    "log-of-an-angle": (
        'alpha = { distribution = "lognormal", median = 40, sd_log = 1 }\n',
        ("alpha", "lognormal"),
    ),
    "negative-median": (
        'C1 = { distribution = "lognormal", median = -1, sd_log = 1 }\n',
        ("C1: the median must be positive",),
    ),
    "loguniform-from-zero": (
        'k2 = { distribution = "loguniform", low = 0, high = 1 }\n',
        ("k2: low must be positive",),
    ),
    "stretch-twice": (
        'mounting_stretch = { distribution = "normal", mean = 1, sd = 0.1 }\n'
        'mounting_stretch_x = { distribution = "normal", mean = 1, sd = 0.1 }\n',
        ("mounting_stretch_x is given twice",),
    ),
}

ACCEPTED = {
    "bom": b"\xef\xbb\xbfkappa = 0.1\n",
    "crlf": b"kappa = 0.1\r\nk1 = '2 * C1'\r\n",
    "comments": "# nur so: äöü\nkappa = 0.1 # dry\n".encode(),
    "exponent": b"C1 = 1e1\nk2 = 0\n",
    "table": b'[alpha]\ndistribution = "normal"\nmean = 41\nsd = 5\n',
    "dotted": b'alpha.distribution = "uniform"\nalpha.low = 10\nalpha.high = 200\n',
}
