"""The calibration problem: one convex QP, composed, built once, solved, certified."""
