"""Hidden machines at the limits of their ranges, and faults that come and go on one machine."""

import numpy as np
import pytest
from support.mirrored import mirrored

from stage import ArgumentError, Stage
from stage.envs import machine_contexts, machine_faults
from stage.envs.observation_features import HOST, Feature
from stage.envs.settings import read_number_option
from stage.envs.step_results import SCORE_FEATURE, StepResults, make_step_result_dtype

PARTS = {"payload": 1.0, "friction": 3.0, "supply": 0.5, "current": 0.8, "loss": 1.5, "inductance": 1.2}
ENDS = {"payload": (2.0, 2.0), "friction": (0.5, 2.0)}


def create_machine():
    stage = Stage("xy", visuals=False)
    return stage, stage.axes["x"], machine_faults.FaultyAxis.from_stage(stage, "x")


@pytest.mark.parametrize("end", [0.5, 2.0])
def test_a_parameter_of_a_machine_can_be_set_to_both_limits(end):
    context = np.zeros((), machine_contexts.CONTEXT)
    machine_contexts.draw_context(np.random.default_rng(1), ENDS, context, {"friction": end})
    assert (context["payload"], context["friction"]) == (2.0, end), "of a range of one number that number is drawn"


def test_a_parameter_can_be_set_to_0_where_its_range_includes_0():
    context = np.zeros((), machine_contexts.CONTEXT)
    ends = {"payload": (0.0, 5.0), "drift": (0.0, 0.1)}
    machine_contexts.draw_context(np.random.default_rng(1), ends, context, {"payload": 0, "drift": 0.0})
    assert (context["payload"], context["drift"]) == (0.0, 0.0)


def test_a_fixed_parameter_does_not_change_the_draws_of_the_others():
    drawn = []
    for requested in ({}, {"payload": 1.0}, {"friction": 1.0, "supply": 1.0}):
        context = np.zeros((), machine_contexts.CONTEXT)
        ends = {
            "payload": (0.0, 5.0),
            "friction": (0.5, 2.0),
            "supply": (0.7, 1.1),
            "current": (0.6, 1.0),
            "loss": (0.56, 1.78),
        }
        machine_contexts.draw_context(np.random.default_rng(3), ends, context, requested)
        drawn.append({name: float(context[name]) for name in ends if name not in requested})
        assert all(context[name] == value for name, value in requested.items())
    assert drawn[0] == drawn[0] | drawn[1] | drawn[2]


@pytest.mark.parametrize("wrong", [True, "1", np.nan, 0.49, 2.01])
def test_an_invalid_parameter_of_a_machine_is_refused(wrong):
    with pytest.raises(ArgumentError, match="option friction="):
        machine_contexts.draw_context(
            np.random.default_rng(1), ENDS, np.zeros((), machine_contexts.CONTEXT), {"friction": wrong}
        )


def test_a_range_of_one_number_is_scaled_to_its_minimum():
    context = np.zeros(2, machine_contexts.CONTEXT)
    context["payload"], context["friction"], context["fault"] = 2.0, (0.5, 2.0), (0, 7)
    assert machine_contexts.scale_contexts(ENDS, context).tolist() == [[-1, -1, 0], [-1, 1, 1]]


@pytest.mark.parametrize("wrong", [True, "1", np.nan, -1, 9])
def test_a_reset_option_outside_its_range_is_refused(wrong):
    assert read_number_option({"payload": 0}, "payload", 1.0, (0.0, 8.0)) == 0
    assert read_number_option({"payload": 8}, "payload", 1.0, (0.0, 8.0)) == 8
    with pytest.raises(ArgumentError, match="option payload="):
        read_number_option({"payload": wrong}, "payload", 1.0, (0.0, 8.0))


def test_a_machine_has_the_parameters_of_its_context_and_the_torque_constant_of_its_motor():
    stage, x, _ = create_machine()
    x.faults.bus_voltage = 36.0
    context = np.zeros((), machine_contexts.CONTEXT)
    for name, value in PARTS.items():
        context[name] = value
    dof, drive, loss = x.plant.dof, stage.state.drives[x.index], stage.model.actuator_damping
    was = stage.model.dof_frictionloss[dof], stage.model.dof_damping[dof]
    motor = x.drive.motor
    carrier = stage.model.body(int(stage.model.jnt_bodyid[x.joint])).name
    created = machine_contexts.NominalMachine.from_stage(stage, "x", carrier)
    for _ in range(2):
        created.apply(stage, context, extra_payload_kg=0.5)
        assert stage.model.dof_frictionloss[dof] == pytest.approx(3 * was[0])
        assert stage.model.dof_damping[dof] == pytest.approx(3 * was[1])
        assert loss.tolist() == pytest.approx([1.5 * motor.core_loss_damping, motor.core_loss_damping])
        assert drive.inductance == pytest.approx(1.2 * motor.inductance)
        assert drive.current == pytest.approx(0.8 * motor.rated_current)
        assert drive.torque_constant == motor.torque_constant
        assert x.faults.bus_voltage == 18.0
        assert stage.payload(carrier) == 1.5


@pytest.mark.parametrize("fault", ["jam", "org open", "org closed", "phase open", "bounce"])
def test_a_fault_is_cleared_by_the_next_fault_and_by_none(fault):
    stage, x, parts = create_machine()
    row, dof = stage.state.switch_table[x.switches.find_index("org")], x.plant.dof

    def observed():
        switch = int(row["forced"]), int(row["bounce"]), int(row["toggles"])
        return *stage.model.dof_solref[dof], *stage.model.dof_solimp[dof], x.faults.open_phases, *switch

    healthy = observed()
    parts.apply(stage, "none")
    assert observed() == healthy
    parts.apply(stage, fault)
    broken = observed()
    assert broken != healthy
    other = "jam" if fault != "jam" else "org open"
    parts.apply(stage, other)
    parts.apply(stage, fault)
    assert observed() == broken
    parts.apply(stage, "none")
    assert observed() == healthy


def test_a_switch_stuck_before_the_episode_stays_stuck_without_a_fault():
    stage, x, _ = create_machine()
    row = stage.state.switch_table[x.switches.find_index("org")]
    row["forced"] = 1
    parts = machine_faults.FaultyAxis.from_stage(stage, "x")
    parts.apply(stage, "org open")
    assert row["forced"] == 0
    parts.apply(stage, "sag")
    assert row["forced"] == 1


def test_a_supply_fault_scales_the_present_supply_voltage():
    stage, x, parts = create_machine()
    x.faults.bus_voltage = 36.0
    parts.apply(stage, "sag")
    assert x.faults.bus_voltage == pytest.approx(0.6 * 36.0)


def test_binding_bearings_also_act_on_a_left_handed_screw(tmp_path):
    stage = Stage(mirrored(tmp_path), visuals=False)
    parts, dof = machine_faults.FaultyAxis.from_stage(stage, "x"), stage.axes["x"].plant.dof
    was = stage.model.dof_frictionloss[dof]
    parts.apply(stage, "binding")
    assert stage.model.dof_frictionloss[dof] > was


def test_a_vector_scores_only_episodes_that_end_in_this_step():
    for hidden in (frozenset(), frozenset({"score"})):
        results = StepResults(
            3, make_step_result_dtype(("time",), (Feature("duration", HOST, "s", kind=float), SCORE_FEATURE)), hidden
        )
        results["score"]["time"], results["terminated"] = [1.0, 2.0, 3.0], [True, True, False]
        reported = results.read_columns(np.array([True, False, True]))
        assert ("score" in reported) == ("score" not in hidden)
        if not hidden:
            assert reported["_score"].tolist() == [True, False, False]
            assert reported["score"]["time"].tolist() == [1.0, 0.0, 0.0]
            assert reported["score"]["_time"].tolist() == [True, False, False]
