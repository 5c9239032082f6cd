"""Puts the laws of this program beside their rivals: one beam, one voltage limit, the same recordings to learn from.

``learned``   what every method may know: recordings, and the beam identified from them
``reversal``  time reversal, and its 1-bit variant
``inverse``   inverse filtering by regularised least squares, throughout and at one instant
``methods``   all of them, each from the same knowledge to voltages
``judging``   what the twin's true beam makes of a drive, which no method may see
``study``     the whole comparison, and what is left of each method on other beams
``words``, ``page``  what came out
"""
