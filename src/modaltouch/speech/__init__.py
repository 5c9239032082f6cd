"""Spoken prompts: the words of a screen as samples, made before the participant sits down.

``espeak``     words to samples, by eSpeak NG in a process of its own
``prompts``    all that a session may say, at the device's rate and the protocol's level
``voice``      mixes one prompt at a time into a stream, and hushes it
``interface``  what the window asks of speech; its absence
"""
