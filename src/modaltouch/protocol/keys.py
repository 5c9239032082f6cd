"""Names of the keys that can answer: those of the window's keyboard layer, in small letters."""

from __future__ import annotations

import string

RESERVED_KEYS = frozenset({"escape"})
"""Keys that the window keeps for itself: Escape pauses the session."""

_NAMED = """
ampersand apostrophe asciicircum asciitilde asterisk at backslash backspace bar begin braceleft braceright
bracketleft bracketright break cancel capslock clear colon comma delete dollar doublequote down end enter equal
escape exclamation execute find function greater help home insert lalt lcommand lctrl left less linefeed lmeta
loption lshift lwindows menu minus numlock pagedown pageup parenleft parenright pause percent period plus pound
print question quoteleft ralt rcommand rctrl redo right rmeta roption rshift rwindows scriptswitch
scrolllock select semicolon slash space sysreq tab underscore undo up
"""

_KEYPAD = """
add begin decimal delete divide down end enter equal f1 f2 f3 f4 home insert left multiply page_down page_up
right separator space subtract tab up
"""

KEY_NAMES = frozenset(
    [
        *string.ascii_lowercase,
        *string.digits,
        *_NAMED.split(),
        *(f"f{number}" for number in range(1, 21)),
        *(f"num_{name}" for name in [*string.digits, *_KEYPAD.split()]),
    ]
)

KEY_ALIASES = {"return": "enter", "esc": "escape", "spacebar": "space", "del": "delete", "ins": "insert"}
"""Other names that people give to keys."""
