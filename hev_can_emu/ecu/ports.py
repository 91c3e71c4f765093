"""The emulated control units' ports: every physical quantity that a frame can carry, in SI.

A *request* is what a unit receives; a *status* is what a unit sends.  Bindings
(:mod:`hev_can_emu.ecu.bindings`) tie DBC signals to these by name.  In the tick both are float64
vectors; NaN means "not available".  The constants below are the vectors' indices: kernels use
``request[EM2_TORQUE_REQUEST]``; requests of one unit lie together, and statuses that copy the truth as
that lies, else their order is free to change.
"""

from __future__ import annotations

from typing import NamedTuple


class Port(NamedTuple):
    """One named quantity: ``unit`` is SI (``1`` for numbers and codes)."""

    name: str
    unit: str
    meaning: str


REQUESTS: tuple[Port, ...] = (
    Port("engine_torque_request", "N m", "torque at the crankshaft, after friction"),
    Port("engine_run_request", "1", "0 stop, 1 run"),
    Port("em1_torque_request", "N m", "torque at the motor shaft, positive drives forward"),
    Port("em1_control_mode", "1", "0 off, 1 torque, 2 speed, 3 freewheel, 4 active short circuit"),
    Port("em1_speed_request", "rad/s", "set speed in speed control"),
    Port("em1_torque_min", "N m", "lower torque bound in speed control"),
    Port("em1_torque_max", "N m", "upper torque bound in speed control"),
    Port("em2_torque_request", "N m", "torque at the motor shaft, positive drives forward"),
    Port("em2_control_mode", "1", "0 off, 1 torque, 2 speed, 3 freewheel, 4 active short circuit"),
    Port("em2_speed_request", "rad/s", "set speed in speed control"),
    Port("em2_torque_min", "N m", "lower torque bound in speed control"),
    Port("em2_torque_max", "N m", "upper torque bound in speed control"),
    Port("clutch_capacity_request", "N m", "torque capacity that C1 is to have; 0 opens it"),
    Port("gear_request", "1", "0 neutral, 1 G1, 2 G2"),
    Port("shift_force_request", "N", "magnitude of the force on the sleeve"),
    Port("brake_torque_request", "N m", "friction brake torque, sum of the four wheels"),
    Port("contactor_request", "1", "0 open, 1 closed"),
    Port("accelerator", "1", "accelerator pedal, 0 to 1"),
    Port("brake_pedal", "1", "brake pedal, 0 to 1"),
    Port("selector", "1", "0 P, 1 R, 2 N, 3 D"),
    Port("ignition", "1", "0 off, 1 accessory, 2 on, 3 start"),
    Port("road_grade", "1", "slope of the road, rise over run, positive uphill"),
    Port("ambient_temperature", "K", "temperature of the surroundings"),
    Port("external_engine_torque", "N m", "actual engine torque, when EMS is external"),
    Port("external_em1_torque", "N m", "actual EM1 torque, when MCU1 is external"),
    Port("external_em2_torque", "N m", "actual EM2 torque, when MCU2 is external"),
    Port("external_clutch_capacity", "N m", "actual C1 capacity, when TCU is external"),
    Port("external_sleeve_position", "m", "actual sleeve position, when TCU is external"),
    Port("external_gear", "1", "actual gear, when TCU is external"),
    Port("external_brake_torque", "N m", "actual friction brake torque, when ESC is external"),
    Port("external_battery_voltage", "V", "battery terminal voltage, when BMS is external"),
    Port("external_discharge_power_limit", "W", "when BMS is external"),
    Port("external_charge_power_limit", "W", "when BMS is external"),
    Port("fault_command", "1", "of a tester: 1 inject, 2 clear, 3 clear all"),
    Port("fault_number", "1", "which of the prepared faults"),
)

STATUSES: tuple[Port, ...] = (
    Port("engine_speed", "rad/s", "crankshaft speed"),
    Port("engine_torque", "N m", "actual torque at the crankshaft, after friction"),
    Port("engine_torque_setpoint", "N m", "request after all limits"),
    Port("engine_limit_reason", "1", "LIMIT_* code: why setpoint and request differ"),
    Port("engine_torque_min", "N m", "smallest torque available now (fuel cut)"),
    Port("engine_torque_max", "N m", "largest torque available now"),
    Port("engine_state", "1", "0 off, 1 cranking, 2 running, 3 stalled, 4 fault"),
    Port("engine_coolant_temperature", "K", "coolant temperature"),
    Port("em1_speed", "rad/s", "EM1 shaft speed, positive forward"),
    Port("em1_torque", "N m", "actual shaft torque, positive drives forward"),
    Port("em1_torque_setpoint", "N m", "set torque after all limits"),
    Port("em1_limit_reason", "1", "LIMIT_* code: why setpoint and request differ"),
    Port("em1_torque_min", "N m", "smallest torque available now"),
    Port("em1_torque_max", "N m", "largest torque available now"),
    Port("em1_dc_power", "W", "positive consumes DC current"),
    Port("em1_temperature", "K", "winding temperature"),
    Port("em1_inverter_temperature", "K", "inverter temperature"),
    Port("em2_speed", "rad/s", "EM2 shaft speed, positive forward"),
    Port("em2_torque", "N m", "actual shaft torque, positive drives forward"),
    Port("em2_torque_setpoint", "N m", "set torque after all limits"),
    Port("em2_limit_reason", "1", "LIMIT_* code: why setpoint and request differ"),
    Port("em2_torque_min", "N m", "smallest torque available now"),
    Port("em2_torque_max", "N m", "largest torque available now"),
    Port("em2_dc_power", "W", "positive consumes DC current"),
    Port("em2_temperature", "K", "winding temperature"),
    Port("em2_inverter_temperature", "K", "inverter temperature"),
    Port("clutch_capacity", "N m", "actual torque capacity of C1"),
    Port("clutch_capacity_setpoint", "N m", "set capacity after all limits"),
    Port("clutch_limit_reason", "1", "LIMIT_* code"),
    Port(
        "clutch_torque", "N m", "torque transmitted through C1, positive from engine to EM1 shaft"
    ),
    Port("clutch_slip", "rad/s", "engine-side minus transmission-side speed"),
    Port("clutch_state", "1", "0 open, 1 slipping, 2 locked"),
    Port("gear", "1", "0 neutral, 1 G1, 2 G2, 3 between"),
    Port("synchronizer_state", "1", "SYNC_* code: phase of the shift"),
    Port("sleeve_position", "m", "sleeve travel, positive towards G1"),
    Port("shift_force", "N", "actual force on the sleeve, positive towards G1"),
    Port("synchronizer_slip", "rad/s", "sleeve speed minus speed of the gear being engaged"),
    Port("synchronizer_limit_reason", "1", "LIMIT_* code: why the request is not carried out"),
    Port("wheel_speed_fl", "m/s", "front left, at the tyre's rolling radius"),
    Port("wheel_speed_fr", "m/s", "front right"),
    Port("wheel_speed_rl", "m/s", "rear left"),
    Port("vehicle_speed", "m/s", "speed of the body"),
    Port("longitudinal_acceleration", "m/s^2", "dv/dt of the body, without gravity"),
    Port(
        "longitudinal_acceleration_sensor",
        "m/s^2",
        "as an accelerometer reads it: with g*sin(slope)",
    ),
    Port("brake_torque", "N m", "actual friction brake torque, sum of the wheels"),
    Port("brake_torque_setpoint", "N m", "set brake torque after all limits"),
    Port("brake_limit_reason", "1", "LIMIT_* code"),
    Port("standstill", "1", "1 while the body is held at rest"),
    Port("state_of_charge", "1", "0 to 1"),
    Port("battery_voltage", "V", "terminal voltage"),
    Port("battery_current", "A", "positive charges"),
    Port("battery_temperature", "K", "cell temperature"),
    Port("battery_limit_reason", "1", "LIMIT_* code"),
    Port("contactor_state", "1", "0 open, 1 precharge, 2 closed, 3 opening, 4 fault"),
    Port("em1_dc_voltage", "V", "voltage at the inverter's DC link"),
    Port("discharge_power_limit", "W", "power that may be discharged"),
    Port("charge_power_limit", "W", "magnitude of the power that may be charged"),
    Port("road_grade_actual", "1", "slope"),
    Port("ambient_temperature_actual", "K", ""),
    Port("wheel_speed_rr", "m/s", "rear right"),
    Port("driving_mode", "1", "MODE_* code"),
    Port("clutch_temperature", "K", "plate temperature"),
    Port(
        "requests_failed", "1", "number of received request messages that are timed out or refused"
    ),
    Port("rejected_frames", "1", "frames refused by protection since the start, modulo 65536"),
    Port("engine_torque_echo", "N m", "torque request as received"),
    Port("engine_request_status", "1", "REQUEST_* code of HCU_EngineRequest"),
    Port("engine_run_echo", "1", "run request as received"),
    Port("em1_torque_echo", "N m", "torque request as received"),
    Port("em1_speed_echo", "rad/s", "speed request as received"),
    Port("em1_state", "1", "0 init, 1 standby, 2 torque, 3 speed, 4 freewheel, 5 ASC, 6 fault"),
    Port("em1_request_status", "1", "REQUEST_* code of HCU_EM1Request"),
    Port("em1_mode_echo", "1", "control mode as received"),
    Port("em1_dc_current", "A", "positive consumes"),
    Port("em2_torque_echo", "N m", "torque request as received"),
    Port("em2_speed_echo", "rad/s", "speed request as received"),
    Port("em2_state", "1", "0 init, 1 standby, 2 torque, 3 speed, 4 freewheel, 5 ASC, 6 fault"),
    Port("em2_request_status", "1", "REQUEST_* code of HCU_EM2Request"),
    Port("em2_mode_echo", "1", "control mode as received"),
    Port("em2_dc_voltage", "V", "voltage at the inverter's DC link"),
    Port("em2_dc_current", "A", "positive consumes"),
    Port("clutch_capacity_echo", "N m", "capacity request as received"),
    Port("clutch_request_status", "1", "REQUEST_* code of HCU_ClutchRequest"),
    Port("gear_echo", "1", "gear request as received"),
    Port("shift_force_echo", "N", "shift force request as received"),
    Port("synchronizer_request_status", "1", "REQUEST_* code of HCU_SynchronizerRequest"),
    Port("brake_torque_echo", "N m", "brake request as received"),
    Port("brake_request_status", "1", "REQUEST_* code of HCU_BrakeRequest"),
    Port("contactor_echo", "1", "contactor request as received"),
    Port("hv_request_status", "1", "REQUEST_* code of HCU_HVRequest"),
    Port("driver_accelerator", "1", "0 to 1"),
    Port("driver_brake", "1", "0 to 1"),
    Port("driver_selector", "1", "0 P, 1 R, 2 N, 3 D"),
    Port("driver_ignition", "1", "0 off, 1 accessory, 2 on, 3 start"),
    Port("faults_active", "1", "number of injected faults active"),
    Port("plant_model", "1", "0 4dof, 1 16dof, 2 detailed"),
    Port("trouble_codes_active", "1", "number of trouble codes whose test fails now"),
    Port("trouble_codes_confirmed", "1", "number of confirmed trouble codes"),
)

# Indices into the request vector.
ENGINE_TORQUE_REQUEST = 0
ENGINE_RUN_REQUEST = 1
EM1_TORQUE_REQUEST = 2
EM1_CONTROL_MODE = 3
EM1_SPEED_REQUEST = 4
EM1_TORQUE_MIN = 5
EM1_TORQUE_MAX = 6
EM2_TORQUE_REQUEST = 7
EM2_CONTROL_MODE = 8
EM2_SPEED_REQUEST = 9
EM2_TORQUE_MIN = 10
EM2_TORQUE_MAX = 11
CLUTCH_CAPACITY_REQUEST = 12
GEAR_REQUEST = 13
SHIFT_FORCE_REQUEST = 14
BRAKE_TORQUE_REQUEST = 15
CONTACTOR_REQUEST = 16
ACCELERATOR = 17
BRAKE_PEDAL = 18
SELECTOR = 19
IGNITION = 20
ROAD_GRADE = 21
AMBIENT_TEMPERATURE = 22
EXTERNAL_ENGINE_TORQUE = 23
EXTERNAL_EM1_TORQUE = 24
EXTERNAL_EM2_TORQUE = 25
EXTERNAL_CLUTCH_CAPACITY = 26
EXTERNAL_SLEEVE_POSITION = 27
EXTERNAL_GEAR = 28
EXTERNAL_BRAKE_TORQUE = 29
EXTERNAL_BATTERY_VOLTAGE = 30
EXTERNAL_DISCHARGE_POWER_LIMIT = 31
EXTERNAL_CHARGE_POWER_LIMIT = 32
FAULT_COMMAND = 33
FAULT_NUMBER = 34

#: Ports of a tester: a network need not carry them.
TESTER_REQUESTS = frozenset({FAULT_COMMAND, FAULT_NUMBER})

# Indices into the status vector.  The first ones lie as the plant's truth does, see :mod:`.reporting`.
S_ENGINE_SPEED = 0
S_ENGINE_TORQUE = 1
S_ENGINE_TORQUE_SETPOINT = 2
S_ENGINE_LIMIT_REASON = 3
S_ENGINE_TORQUE_MIN = 4
S_ENGINE_TORQUE_MAX = 5
S_ENGINE_STATE = 6
S_ENGINE_COOLANT_TEMPERATURE = 7
S_EM1_SPEED = 8
S_EM1_TORQUE = 9
S_EM1_TORQUE_SETPOINT = 10
S_EM1_LIMIT_REASON = 11
S_EM1_TORQUE_MIN = 12
S_EM1_TORQUE_MAX = 13
S_EM1_DC_POWER = 14
S_EM1_TEMPERATURE = 15
S_EM1_INVERTER_TEMPERATURE = 16
S_EM2_SPEED = 17
S_EM2_TORQUE = 18
S_EM2_TORQUE_SETPOINT = 19
S_EM2_LIMIT_REASON = 20
S_EM2_TORQUE_MIN = 21
S_EM2_TORQUE_MAX = 22
S_EM2_DC_POWER = 23
S_EM2_TEMPERATURE = 24
S_EM2_INVERTER_TEMPERATURE = 25
S_CLUTCH_CAPACITY = 26
S_CLUTCH_CAPACITY_SETPOINT = 27
S_CLUTCH_LIMIT_REASON = 28
S_CLUTCH_TORQUE = 29
S_CLUTCH_SLIP = 30
S_CLUTCH_STATE = 31
S_GEAR = 32
S_SYNCHRONIZER_STATE = 33
S_SLEEVE_POSITION = 34
S_SHIFT_FORCE = 35
S_SYNCHRONIZER_SLIP = 36
S_SYNCHRONIZER_LIMIT_REASON = 37
S_WHEEL_SPEED_FL = 38
S_WHEEL_SPEED_FR = 39
S_WHEEL_SPEED_RL = 40
S_VEHICLE_SPEED = 41
S_LONGITUDINAL_ACCELERATION = 42
S_LONGITUDINAL_ACCELERATION_SENSOR = 43
S_BRAKE_TORQUE = 44
S_BRAKE_TORQUE_SETPOINT = 45
S_BRAKE_LIMIT_REASON = 46
S_STANDSTILL = 47
S_STATE_OF_CHARGE = 48
S_BATTERY_VOLTAGE = 49
S_BATTERY_CURRENT = 50
S_BATTERY_TEMPERATURE = 51
S_BATTERY_LIMIT_REASON = 52
S_CONTACTOR_STATE = 53
S_EM1_DC_VOLTAGE = 54
S_DISCHARGE_POWER_LIMIT = 55
S_CHARGE_POWER_LIMIT = 56
S_ROAD_GRADE_ACTUAL = 57
S_AMBIENT_TEMPERATURE_ACTUAL = 58
S_WHEEL_SPEED_RR = 59
S_DRIVING_MODE = 60
S_CLUTCH_TEMPERATURE = 61
S_REQUESTS_FAILED = 62
S_REJECTED_FRAMES = 63
S_ENGINE_TORQUE_ECHO = 64
S_ENGINE_REQUEST_STATUS = 65
S_ENGINE_RUN_ECHO = 66
S_EM1_TORQUE_ECHO = 67
S_EM1_SPEED_ECHO = 68
S_EM1_STATE = 69
S_EM1_REQUEST_STATUS = 70
S_EM1_MODE_ECHO = 71
S_EM1_DC_CURRENT = 72
S_EM2_TORQUE_ECHO = 73
S_EM2_SPEED_ECHO = 74
S_EM2_STATE = 75
S_EM2_REQUEST_STATUS = 76
S_EM2_MODE_ECHO = 77
S_EM2_DC_VOLTAGE = 78
S_EM2_DC_CURRENT = 79
S_CLUTCH_CAPACITY_ECHO = 80
S_CLUTCH_REQUEST_STATUS = 81
S_GEAR_ECHO = 82
S_SHIFT_FORCE_ECHO = 83
S_SYNCHRONIZER_REQUEST_STATUS = 84
S_BRAKE_TORQUE_ECHO = 85
S_BRAKE_REQUEST_STATUS = 86
S_CONTACTOR_ECHO = 87
S_HV_REQUEST_STATUS = 88
S_DRIVER_ACCELERATOR = 89
S_DRIVER_BRAKE = 90
S_DRIVER_SELECTOR = 91
S_DRIVER_IGNITION = 92
S_FAULTS_ACTIVE = 93
S_PLANT_MODEL = 94
S_TROUBLE_CODES_ACTIVE = 95
S_TROUBLE_CODES_CONFIRMED = 96

# Why a setpoint differs from its request.
LIMIT_NONE, LIMIT_SPEED, LIMIT_VOLTAGE, LIMIT_BATTERY_POWER, LIMIT_TEMPERATURE = 0, 1, 2, 3, 4
LIMIT_SLEW, LIMIT_DISABLED, LIMIT_REQUEST_LOST, LIMIT_RANGE, LIMIT_TORQUE_BOUND = 5, 6, 7, 8, 9
LIMIT_TORQUE_ON_DOGS, LIMIT_SYNC_TIMEOUT, LIMIT_FAULT, LIMIT_PEAK = 10, 11, 12, 13

# How a received request message fares.
REQUEST_OK, REQUEST_NEVER, REQUEST_TIMEOUT, REQUEST_CRC, REQUEST_COUNTER = 0, 1, 2, 3, 4
(
    REQUEST_LENGTH,
    REQUEST_RANGE,
    REQUEST_NOT_AVAILABLE,
    REQUEST_CHANGED_TOO_FAST,
    REQUEST_IMPLAUSIBLE,
) = (
    5,
    6,
    7,
    8,
    9,
)

# Phases of a shift.
SYNC_NEUTRAL, SYNC_TRAVEL, SYNC_SYNCHRONISING, SYNC_INDEX, SYNC_ENGAGED = 0, 1, 2, 3, 4
SYNC_DISENGAGING, SYNC_ABORTED, SYNC_BLOCKED_BY_TORQUE, SYNC_GRATING = 5, 6, 7, 8
SYNC_TOOTH_ON_TOOTH = 9

# Driving modes.
MODE_TRANSITION, MODE_SERIES, MODE_PARALLEL_G1, MODE_PARALLEL_G2 = 0, 1, 2, 3
MODE_ELECTRIC_NEUTRAL, MODE_ELECTRIC_G1, MODE_ELECTRIC_G2 = 4, 5, 6

# Control modes of EM1 and EM2.
CONTROL_OFF, CONTROL_TORQUE, CONTROL_SPEED, CONTROL_FREEWHEEL, CONTROL_ASC = 0, 1, 2, 3, 4
