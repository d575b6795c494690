# Sourced: a virtual environment in the folder $1 with the install target $2.
# Finds a Python of at least 3.11; reinstalls only when pyproject.toml changed.

environment_folder="$1"
environment_target="$2"

for environment_python in "${PYTHON:-}" python3 python3.14 python3.13 python3.12 python3.11 python; do
    if [ -n "$environment_python" ] && "$environment_python" -c \
        'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
        break
    fi
    environment_python=""
done
if [ -z "$environment_python" ]; then
    echo "biaxbayes needs Python 3.11 or newer; set PYTHON=/path/to/python" >&2
    exit 2
fi

environment_stamp="$environment_folder/.installed"
if ! [ -x "$environment_folder/bin/python" ]; then
    echo "making the environment $environment_folder ..."
    "$environment_python" -m venv "$environment_folder"
fi
# shellcheck disable=SC1091
source "$environment_folder/bin/activate"
if ! [ -e "$environment_stamp" ] || [ pyproject.toml -nt "$environment_stamp" ]; then
    echo "installing biaxbayes and what it needs (a minute or two the first time) ..."
    python -m pip install --quiet --disable-pip-version-check --upgrade pip
    python -m pip install --quiet --disable-pip-version-check --editable "$environment_target"
    touch "$environment_stamp"
fi
