"""Layout of the sleeve's state and output, and the zones of its travel."""

# Where the sleeve is.
CENTRE, FREE, PRESYNC, BLOCKED, INDEXING, FLIGHT = 0, 1, 2, 3, 4, 5
TOOTH_ON_TOOTH, GRATING, ENTERING, ENGAGED, STOP = 6, 7, 8, 9, 10

# Layout of the state: position m and velocity m/s, positive towards G1; how far the ring has turned out
# of the way (1: the sleeve may pass); 1 while the dogs grate; zone; sign of the torque on the sleeve that
# keeps the ring blocking; what the chamfers press with, N, and their torque on the sleeve, N m, as told;
# angle last seen, rad.
X_POSITION, X_VELOCITY, X_RING, X_GRATING, X_ZONE = 0, 1, 2, 3, 4
X_BLOCKING_SIGN, X_PRESS, X_TORQUE, X_ANGLE = 5, 6, 7, 8
N_STATE = 9

# Layout of the output.  From OUT_WORK on: J in this step.
OUT_POSITION, OUT_VELOCITY = 0, 1
OUT_CONE1, OUT_CONE2 = 2, 3  # capacities of the cones, N m
OUT_DOG1, OUT_DOG2 = 4, 5  # 1 while the dogs overlap
OUT_GAP1, OUT_GAP2 = 6, 7  # sleeve within the play when the dogs go in, rad
OUT_DRAG1, OUT_DRAG2 = 8, 9  # friction capacity of dogs that stand or grate on each other, N m
OUT_CHAMFER1, OUT_CHAMFER2 = 10, 11  # signed torque of the chamfers on the sleeve, N m
OUT_ZONE, OUT_RING_FORCE = 12, 13  # zone; force on the ring, N
OUT_WORK, OUT_KINETIC, OUT_ELASTIC = 14, 15, 16
OUT_DAMPING_LOSS, OUT_FRICTION_LOSS, OUT_STOP_LOSS = 17, 18, 19
OUT_TOOTH_WORK, OUT_TOOTH_LAG = 20, 21
N_OUT = 22
