"""The filters and their mathematics: FastSLAM 1.0, FastSLAM 2.0, Dual FastSLAM and EKF-SLAM.

Knows nothing of worlds, files, clocks or viewers.  SI units and radians throughout.  Equation numbers are those of
D. Rodriguez-Losada, P. San Segundo, F. Matia, L. Pedraza, "Dual FastSLAM: Dual Factorization of the Particle Filter
Based Solution of the Simultaneous Localization and Mapping Problem", J. Intell. Robot. Syst. 55 (2009) 109-134.
"""
