"""The paper's Figures 2 and 4 to 21, the claims of the text about them, and whether they hold.

> H. Gao, X. Li, C. Gao, J. Wu, Neural Network Supervision Control Strategy for Inverted Pendulum
> Tracking Control, Discrete Dynamics in Nature and Society, 2021 (CC BY).
"""
