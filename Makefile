PYTHON ?= python3
BIN := .venv/bin
OUT ?= demo

.PHONY: demo test slow mutants check bench docs docs-shown docs-tables clean

demo: .venv/installed
	$(BIN)/bssrdf demo --out $(OUT) --force

test: .venv/installed
	$(BIN)/python -m pytest -n 2 --dist loadfile

slow: .venv/installed
	$(BIN)/python -m pytest -m slow

mutants: .venv/installed
	$(BIN)/python tests/mutants.py

check: .venv/installed
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python tests/words.py

bench: .venv/installed
	$(BIN)/bssrdf bench fit --history bench/history.jsonl

docs: .venv/installed
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs build/site

docs-shown: .venv/installed
	$(BIN)/python docs/shown.py

docs-tables: .venv/installed
	$(BIN)/python docs/tables.py

.venv/installed: pyproject.toml constraints.txt .ci/apt
	.ci/apt
	$(PYTHON) -c 'import sys; sys.exit(None if (3, 11) <= sys.version_info[:2] <= (3, 13) else "bssrdf needs Python 3.11 to 3.13: make PYTHON=python3.12")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev,batch,camera,docs,export,formats,render]'
	touch $@

clean:
	rm -rf .venv build dist *.egg-info
