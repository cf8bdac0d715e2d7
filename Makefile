# make study   the whole chain on the default head -> out/study/index.html
# make test    tests, a worker for each core      make check   ruff, mypy, import-linter, cog, the pages
# make wheel   the wheel in an environment of its own, of a gigabyte that is kept: it solves, fits, animates and shows
# make check-results  a cheap part of every kept result measured anew: names what is stale and what moved; ten minutes
# make fuzz    damaged files for every reader, MUTANTS=... of each format, others each time
# make docs    the pages, their programs run -> out/docs/index.html; installs Sphinx and its themes besides (extra "docs")
# Each does first all set-up that is missing (tools/set-up), which says what it will install before it does, and
# starts at once when nothing is missing.
.PHONY: study test wheel check check-results fuzz docs setup clean
PYTHON := .venv/bin/python
MUTANTS ?= 2000
# Whether `make check` runs the programs among the pages: off, or force.
PAGES ?= off

study: setup
	.venv/bin/softdeca study

test: setup
	$(PYTHON) -m pytest -n auto --dist loadfile --no-loadscope-reorder --ignore tests/end_to_end/test_wheel.py

wheel: setup
	$(PYTHON) -m pytest tests/end_to_end/test_wheel.py

check: setup
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	rm -rf build/lib build/typecheck && $(PYTHON) -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --target build/typecheck .
	cd build/typecheck && ../../.venv/bin/mypy --config-file ../../pyproject.toml --namespace-packages --explicit-package-bases softdeca
	.venv/bin/lint-imports
	.venv/bin/cog --check -I docs README.md animation/live/face.py docs/*.md docs/first-hour/*.md
	@tools/set-up docs
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(PYTHON) -m sphinx --quiet --fail-on-warning --keep-going -D nb_execution_mode=$(PAGES) -D suppress_warnings=myst-nb.lexer docs build/docs

check-results: setup
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(PYTHON) tools/kept.py check

fuzz: setup
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(PYTHON) -m tests.fuzz --mutants $(MUTANTS)

docs:
	@tools/set-up docs
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(PYTHON) -m sphinx --quiet --fail-on-warning --keep-going docs out/docs

setup:
	@tools/set-up

clean:
	rm -rf .venv build out *.egg-info
