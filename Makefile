# `make demo` and `make test` need python3 (3.11 or newer) with venv; they set up everything else, once, in .venv
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test test-slow fuzz lint bench results pictures clean help

help:
	@echo "make demo       origin return, dual-rate and a:b moves; writes demo.rrd"
	@echo "make test       the everyday test suite"
	@echo "make test-slow  the long checks"
	@echo "make fuzz       fuzz the bus and the MJCF contract, SECONDS=60 each (extra fuzz)"
	@echo "make lint       ruff and mypy"
	@echo "make bench      speed, as ratios measured in one run"
	@echo "make results    baselines of RegisterTuning: docs/results.md (extra rl; a quarter of an hour)"
	@echo "make pictures   draw every picture of README and docs again"

$(BIN)/python:
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install -q --upgrade pip

.venv/.user: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install -q -e '.[plot]'
	@touch $@

.venv/.dev: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install -q -e '.[dev]'
	@touch $@ .venv/.user

demo: .venv/.user
	$(BIN)/stage demo

test: .venv/.dev
	$(BIN)/python -m pytest -n 2 --dist worksteal

test-slow: .venv/.dev
	$(BIN)/python -m pytest -n 2 -m slow

SECONDS ?= 60
fuzz: .venv/.dev
	$(BIN)/python -m pip install -q -e '.[fuzz]'
	$(BIN)/python scripts/fuzz.py bus --seconds $(SECONDS)
	$(BIN)/python scripts/fuzz.py mjcf --seconds $(SECONDS)

lint: .venv/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: .venv/.dev
	$(BIN)/python scripts/benchmark.py
	$(BIN)/python scripts/benchmark_envs.py --most 64 --rounds 3

results: .venv/.dev
	$(BIN)/python -m pip install -q -e '.[rl,plot]'
	$(BIN)/python scripts/baselines/results.py

pictures: .venv/.dev
	$(BIN)/stage demo --no-view --force --picture docs/pictures/dashboard.png
	$(BIN)/stage home x --from -90 --force --plot docs/pictures/origin_return.png
	$(BIN)/stage pullout --force --plot docs/pictures/pullout.png
	for script in render_models stepper_behaviours draw_patterns synchronized_survey; do $(BIN)/python scripts/$$script.py || exit 1; done
	$(BIN)/python scripts/ramp_down_survey.py
	for script in s_curve origin_spread; do $(BIN)/python scripts/$$script.py --picture docs/pictures/$$script.png || exit 1; done

clean:
	rm -rf .venv build dist *.egg-info .pytest_cache .hypothesis .ruff_cache .mypy_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
