"""Noise that masks the sound of the beam, without a break from before the first trial until after the last.

``noise``      one period of pink or white noise, without a seam
``playback``   samples out of that period, faded in and out
``interface``  what the session asks of masking; its absence
``device``     a sound device, and a stream on it
``player``     the noise on a sound device
"""
