"""The paper's Figures 2 and 4 to 21: what they show, what the text says of them, whether it holds.

> H. Gao, X. Li, C. Gao, J. Wu, Neural Network Supervision Control Strategy for Inverted Pendulum
> Tracking Control, Discrete Dynamics in Nature and Society, 2021 (CC BY).
"""
