"""What the participant hears: noise that masks the sound of the beam, without a break, and prompts on top of it.

``noise``      one period of pink or white noise, without a seam
``playback``   samples out of that period, faded in and out
``interface``  what the session asks of masking; its absence
``device``     a sound device, and a stream on it
``player``     noise and prompts on a sound device, in one stream
"""
