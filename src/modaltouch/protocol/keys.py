"""Names of the keys that can answer: those of the window's keyboard layer, in small letters."""

from __future__ import annotations

import string

PAUSE_KEY = "escape"
"""Key that pauses the session."""

RESERVED_KEYS = frozenset({PAUSE_KEY})
"""Keys that the window keeps for itself."""

END_KEY = "q"
"""Key that ends the session from the pause screen; elsewhere it may answer."""

_NAMED = """
ampersand apostrophe asciicircum asciitilde asterisk at backslash backspace bar begin braceleft braceright
bracketleft bracketright break cancel capslock clear colon comma delete dollar doublequote down end enter equal
escape exclamation execute find function greater help home insert lalt lcommand lctrl left less linefeed lmeta
loption lshift lwindows menu minus numlock pagedown pageup parenleft parenright pause percent period plus pound
print question quoteleft ralt rcommand rctrl redo right rmeta roption rshift rwindows scriptswitch
scrolllock select semicolon slash space sysreq tab underscore undo up
"""

_KEYPAD = """
add decimal divide enter equal f1 f2 f3 f4 multiply separator space subtract tab
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

KEY_ALIASES = {
    "return": "enter",
    "esc": "escape",
    "spacebar": "space",
    "num_insert": "num_0",
    "num_end": "num_1",
    "num_down": "num_2",
    "num_page_down": "num_3",
    "num_left": "num_4",
    "num_begin": "num_5",
    "num_right": "num_6",
    "num_home": "num_7",
    "num_up": "num_8",
    "num_page_up": "num_9",
    "num_delete": "num_decimal",
    "é": "2",
    "è": "7",
    "ç": "9",
    "à": "0",
}
"""Other names that people give to keys.

The number pad is one set of keys with and without NumLock; a French keyboard's row of digits types them with Shift, and
goes by its digits.
"""
