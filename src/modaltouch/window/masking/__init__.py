"""Noise that masks the sound of the beam, without a break from before the first trial until after the last.

``noise``      one period of pink or white noise, without a seam
``interface``  what the session asks of masking; its absence
``player``     a sound device, and the noise on it
"""
