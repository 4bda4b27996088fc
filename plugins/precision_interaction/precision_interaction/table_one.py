"""Table I of the paper, and the published contact points: the defaults of every model and teacher of this package."""

import math

MAX_SPEED_UM_S = 100.0
MAX_ACCELERATION_UM_S2 = 20.0
STIFFNESS_MN_UM = 80.0
LENGTH_UM = 2050.0
GAP_UM = 50.0
GAMMA_A = 0.5 * math.log(2.0)
GAMMA_C = 1.0
GAMMA_F = 1.0
GAMMA_H = 0.9
T_N = 0.5
SIGMA_0_MN = 100.0
BETA_0 = 0.3
IMAGINED_PERIODS = 3

# The paper is silent on the speed a run starts at and on the slowest useful one; the two are one choice.
CREEP_SPEED_UM_S = 2.0

# What a forecast cannot resolve on the paper's rig: (stage resolution * M)^2 / 12 + (sensor resolution)^2 / 12.
STAGE_RESOLUTION_UM = 0.5
ELEVATOR_RESOLUTION_UM = 0.1
FORCE_RESOLUTION_MN = 1000.0 / 128.0
UNRESOLVED_VARIANCE_MN2 = ((STAGE_RESOLUTION_UM * STIFFNESS_MN_UM) ** 2 + FORCE_RESOLUTION_MN**2) / 12.0

# Least squares through the origin on the published means and variances at 10 and 50 um (x, y).
PROPORTIONAL_MEAN_MN_UM = (0.618, 1.072)
PROPORTIONAL_VARIANCE_MN2_UM = (1.172, 0.535)

# The line through the same two points: intercept and slope (x, y).
MEASURED_MEAN_INTERCEPT_MN = (8.475, 12.45)
MEASURED_MEAN_SLOPE_MN_UM = (0.4225, 0.785)
MEASURED_VARIANCE_INTERCEPT_MN2 = (14.925, 2.15)
MEASURED_VARIANCE_SLOPE_MN2_UM = (0.8275, 0.485)
