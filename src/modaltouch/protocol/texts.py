"""Texts shown to the participant, in one language."""

from __future__ import annotations

import re
import string
import unicodedata
from collections.abc import Iterable, Iterator
from typing import Annotated

from pydantic import AfterValidator, Field, ValidationInfo, field_validator

from modaltouch.protocol.conditions import FingerName, offered_answers
from modaltouch.protocol.reading import Reading
from modaltouch.protocol.section import Section, Text, Word, described, plain_word
from modaltouch.protocol.sections import Protocol
from modaltouch.protocol.source import EMPTY, Problem, fault, suggest
from modaltouch.protocol.trial import RATED, SHIPPED

_PLACEHOLDERS: dict[str, frozenset[str]] = {
    "how_to_answer": frozenset({"pause_key"}),
    "how_to_answer_or_none": frozenset({"pause_key"}),
    "place_fingers": frozenset({"left_finger", "left_zone", "right_finger", "right_zone"}),
    "place_each_finger": frozenset({"finger", "zone"}),
    "trial_of": frozenset({"number", "total"}),
    "practice_of": frozenset({"number", "total"}),
    "pause": frozenset({"key", "end_key"}),
    "pause_between_trials": frozenset({"key", "end_key"}),
    "press_to_continue": frozenset({"key"}),
    "placed_by_free_hand": frozenset({"key", "hand"}),
    "placed_by_hand_on_beam": frozenset({"key", "hand"}),
    "free_hand_answers": frozenset({"hand"}),
    "how_to_rate": frozenset({"pause_key"}),
    "practice_was": frozenset({"answer"}),
    "confirm_rating": frozenset({"key"}),
}
"""Placeholders that a text must contain; other texts must contain none."""

_OPTIONAL: dict[str, frozenset[str]] = {
    "instructions": frozenset({"vibrates", "n_fingers", "asked"}),
    "how_to_answer": frozenset({"n_answers"}),
    "how_to_answer_or_none": frozenset({"n_answers", "nothing_felt"}),
    "lift_to_answer": frozenset({"hand"}),
}
"""Placeholders that a text may contain; older files lack them."""


def _check_text(text: str, wanted: frozenset[str] = frozenset(), optional: frozenset[str] = frozenset()) -> str:
    """Validate a text: not empty, with all required placeholders, and no others except the optional ones."""
    if not text.strip():
        raise fault(*EMPTY)
    needed = _in_braces(wanted)
    if optional:
        needed += f", and if you like {_in_braces(optional)}"
    try:
        fields = [field for field in string.Formatter().parse(text) if field[1] is not None]
    except ValueError as error:
        raise fault(f"{text!r} ({error})", needed, "close every brace") from None
    found = {str(name) for _, name, _, _ in fields}
    if found - optional != wanted or any(spec or conversion for _, _, spec, conversion in fields):
        remedy = "write each of them once" if wanted else "leave the others out"
        raise fault(f"{_in_braces(found)} in {text!r}", f"exactly {needed}" if wanted else needed, remedy)
    return text


def _in_braces(names: Iterable[str]) -> str:
    return ", ".join(f"{{{name}}}" for name in sorted(names)) or "no words in braces"


_PLACE = {"x-allowed": "the name of an installed font's file, without folders, or its absolute path"}
FontFile = Annotated[str, Field(pattern=r"^([^/\\]*|(/|[A-Za-z]:\\).*)$", json_schema_extra=_PLACE)]


class Texts(Section):
    """All texts shown to the participant, in one language."""

    language: Text = described("Name of the language, in that language.")
    language_code: Text | None = described("Its code (BCP 47), such as en or fr.", default=None)
    font: FontFile = described("Installed font that is used before Noto's, such as Amiri-Regular.ttf.", default="")
    welcome: Text = described("Greeting on the first screen.")
    vibrates: tuple[Text, Text, Text, Text] | None = described(
        "How the beam vibrates in a trial of one, two or three intervals, and of intervals of which only one is not "
        "silent; for {vibrates} in the instructions.",
        default=None,
    )
    n_fingers: tuple[Text, Text, Text, Text] | None = described(
        "One, two, three fingers, and fingers whose number varies; for {n_fingers} in the instructions.", default=None
    )
    asked: dict[Word, Annotated[Text, Field(min_length=1), AfterValidator(_check_text)]] = described(
        "What the participant is to say, for {asked} in the instructions, by the name of the question; `other` for a "
        "question that is not listed.",
        default={},
    )
    instructions: Text = described(
        "What the experiment asks of the participant; may contain {vibrates}, {n_fingers} and {asked}, which follow "
        "the design."
    )
    how_to_answer: Text = described("How to answer and to pause; contains {pause_key}, may contain {n_answers}.")
    how_to_answer_or_none: Text | None = described(
        "Used instead of how_to_answer if an answer says that nothing was felt; contains {pause_key}, may contain "
        "{n_answers} and {nothing_felt}, the label of that answer.",
        default=None,
    )
    numbers: tuple[Text, ...] = described(
        "Words for the numbers two, three and so on; a digit is used for larger numbers.", default=()
    )
    place_fingers: Text = described(
        "Which finger goes where; contains {left_finger}, {left_zone}, {right_finger}, {right_zone}."
    )
    place_each_finger: Text | None = described(
        "The same for one finger or three, one line per finger; contains {finger} and {zone}.", default=None
    )
    practice: Text = described("Announces the practice trials.")
    start: Text = described("Announces the trials that count.")
    feel: Text = described("Shown while the stimulus plays and before the question.")
    question: Text = described("The question.")
    left: Text = described("The answer left.")
    both: Text = described("The answer both.")
    right: Text = described("The answer right.")
    none: Text | None = described("The answer none, if the protocol offers it.", default=None)
    answers: dict[Word, Annotated[Text, Field(min_length=1), AfterValidator(_check_text)]] = described(
        "Labels of answers with other names, by their name in the protocol.", default={}
    )
    further: dict[Word, Annotated[Text, Field(min_length=1), AfterValidator(_check_text)]] = described(
        "Further texts, by name, which a protocol can use as its question, its instructions, or a further question.",
        default={},
    )
    trial_of: Text = described("Progress; contains {number} and {total}.")
    practice_of: Text = described("Progress in practice; contains {number} and {total}.")
    rest: Text = described("Shown in a break.")
    pause: Text = described("Shown in a pause that interrupted a trial; contains {key} and {end_key}.")
    pause_between_trials: Text = described("Shown in any other pause; contains {key} and {end_key}.")
    session_ended: Text = described("Shown for a moment if a session ends early, unless the participant ended it.")
    goodbye: Text = described("Thanks at the end.")
    press_to_continue: Text = described("How to continue; contains {key}.")
    experimenter_answers: Text = described("Says that the experimenter types the spoken answer.")
    placed_by_free_hand: Text | None = described(
        "Used instead of press_to_continue if a hand that is not on the beam confirms a placement; contains {key}, "
        "{hand}.",
        default=None,
    )
    placed_by_hand_on_beam: Text | None = described(
        "The same if a hand that rests on the beam confirms it and then returns; contains {key}, {hand}.", default=None
    )
    placed_by_experimenter: Text | None = described("The same if the experimenter confirms it.", default=None)
    free_hand_answers: Text | None = described("Says that the free hand answers; contains {hand}.", default=None)
    lift_to_answer: Text = described(
        "Says that a hand or finger leaves the beam to press the answer, and that lifting it does not count; may "
        "contain {hand}."
    )
    foot_switch_answers: Text = described("Says that the foot switch answers.")
    fingers_back: Text = described(
        "Asks for the fingers back on the beam, above the countdown to the next stimulus or by itself."
    )
    stalled: Text = described(
        "Shown for a moment if the computer was held up and a stimulus is presented again.",
        default="One moment, please.\n\nThe computer was held up.\n\nThe last vibration is repeated.",
    )
    hands_off: Text = described(
        "Asks for hands off the beam, which is then measured, if fingers are measured in the session.",
        default="Please lift your hands.\n\nThe beam will be measured without them.",
    )
    measuring: Text = described(
        "Shown while the beam is measured, with hands off and under the fingers.",
        default="One moment, please.\n\nThe beam is being measured. Keep still.",
    )
    measure_again: Text = described(
        "Asks for the fingers once more if they could not be measured.",
        default="Once more, please.\n\nThe measurement did not succeed.\n\nTouch the beam as before, and keep still.",
    )
    how_to_rate: Text = described(
        "Used instead of how_to_answer if the answer is a place or number on a scale; contains {pause_key}.",
        default="Each time, give your answer here, and confirm it.\n\nThere is no right or wrong here: tell us what "
        "you feel, and if in doubt trust your first impression. Press {pause_key} whenever you need a pause.",
    )
    confirm_rating: Text = described(
        "Label of the button that confirms the mark or number on a scale; contains {key}.", default="Confirm: {key}"
    )
    confirm_answer: Text = described("How to confirm or change an answer, if the protocol allows changes.")
    practice_agreed: Text = described("After a practice trial: the answer was the stronger finger.")
    practice_was_left: Text = described("After a practice trial: the left finger's vibration was the stronger one.")
    practice_was_both: Text = described("After a practice trial: both vibrations were about equally strong.")
    practice_was_right: Text = described("After a practice trial: the right finger's vibration was the stronger one.")
    practice_was: Text = described(
        "After a practice trial whose answers name intervals, or one of three fingers: the right answer, {answer}.",
        default="This time the right answer was: {answer}",
    )
    practice_again: Text = described("Announces another round of practice.")
    right_index: Text = described("The right index finger.")
    right_middle: Text = described("The right middle finger.")
    left_index: Text = described("The left index finger.")
    left_middle: Text = described("The left middle finger.")
    fingers: dict[FingerName, Annotated[Text, AfterValidator(_check_text)]] = described(
        "Further fingers, if the protocol uses them, such as `right ring: right ring finger`.", default={}
    )
    right_hand: Text = described("The right hand, when it presses the key.", default="right hand")
    left_hand: Text = described("The left hand, when it presses the key.", default="left hand")
    key_names: dict[str, Text] = described(
        "Keys as the participant knows them, by their name in the protocol.", default={}
    )

    @field_validator("*")
    @classmethod
    def _holds_its_placeholders(cls, text: object, info: ValidationInfo) -> object:
        """Reject an empty text, or one whose placeholders differ from those that the window fills in."""
        name = str(info.field_name)
        if isinstance(text, str):
            optional = _OPTIONAL.get(name, frozenset())
            if name == "instructions":
                # One that is itself invalid is reported at its own key.
                optional = frozenset(each for each in optional if info.data.get(each, True))
            _check_text(text, _PLACEHOLDERS.get(name, frozenset()), optional)
        return text

    def fitted(self, protocol: Protocol) -> Texts:
        """Return the texts with instructions and question adapted to a protocol's design."""
        task, intervals, counts = protocol.task, protocol.intervals, {*map(len, protocol.conditions.contacts)}
        n_intervals = 1 if intervals is None else 4 if intervals.standard.velocity_mm_s == 0 else intervals.number
        words = {
            "vibrates": self.vibrates and self.vibrates[n_intervals - 1],
            "n_fingers": self.n_fingers and self.n_fingers[min(counts) - 1 if len(counts) == 1 else 3],
            "asked": self.asked.get(task) or self.asked.get("other", ""),
        }
        own = protocol.instructions
        instructions = self.named(own) if own else self.instructions.format(**words)
        return self.model_copy(update={"instructions": instructions, "question": self.further.get(task, self.question)})

    def number(self, count: int) -> str:
        """Format a number of answers for the participant."""
        return dict(enumerate(self.numbers, 2)).get(count, str(count))

    def finger(self, name: str) -> str:
        """Return the participant's word for a finger such as ``left index``."""
        return self.fingers.get(name) or str(getattr(self, name.replace(" ", "_")))  # type: ignore[call-overload]

    def placing(self, fingers: tuple[str, ...], zones: tuple[str, ...]) -> str:
        """Return the instruction that assigns fingers to zones."""
        if len(zones) != 2:
            each = self.place_each_finger or ""
            lines = (each.format(finger=finger, zone=zone) for finger, zone in zip(fingers, zones, strict=True))
            return "\n".join(line[:1].upper() + line[1:] for line in lines)
        return self.place_fingers.format(
            left_finger=fingers[0], left_zone=zones[0], right_finger=fingers[1], right_zone=zones[1]
        )

    def label(self, answer: str) -> str:
        """Return the label of an answer."""
        return self.answers.get(answer) or str(getattr(self, answer, answer))

    def named(self, words: str) -> str:
        """Return the further text with a name, or the name itself if there is none."""
        return self.further.get(words, words)


def check_words(protocol: Reading[Protocol], texts: Reading[Texts]) -> Iterator[Problem]:
    """Yield a problem for each text that the protocol needs and the language file lacks, at the key that needs it."""
    offered = offered_answers(protocol)
    wanted: list[tuple[tuple[str, ...], tuple[str, ...]]] = []
    lists: list[tuple[tuple[str, ...], tuple[str, ...]]] = []
    lists += [(("answers", "keys"), offered.names)] if offered.names != (RATED,) else []
    for section in (("answers", "then"), ("form",)):
        for name, question in protocol.items(*section):
            wanted += [((*section, name), ("further", name))] if question.question is None else []
            lists.append(((*section, name, "keys"), tuple(question.keys)))
    for keys, names in lists:
        labels = [
            (name, name if re.fullmatch(r"[A-Za-z0-9_-]{1,32}", name) else plain_word(name) or name) for name in names
        ]
        wanted += [((*keys, name), (label,) if name in SHIPPED else ("answers", label)) for name, label in labels]
    if offered.naming() is not None:
        wanted.append((("answers", "keys"), ("how_to_answer_or_none",)))
    for named in (("answers", "question"), ("instructions",)):
        words = protocol.sound(*named)
        wanted += [(named, ("further", words))] if words and re.fullmatch(r"[A-Za-z0-9_-]{1,32}", words) else []
    if protocol.value is not None:
        design = protocol.value.conditions
        fingers = [name for name in design.fingers_used if name.replace(" ", "_") not in Texts.model_fields]
        wanted += [(("conditions", "finger_conditions"), ("fingers", name)) for name in fingers]
        if any(len(zones) != 2 for zones in design.contacts):
            wanted.append((("conditions", "zones"), ("place_each_finger",)))
    absent = [name for name in SHIPPED if name not in offered.names]
    for path, place in wanted if texts.root is not None else ():
        node = texts.find(place)
        # Missing required keys are also reported without a protocol.
        if Texts.model_fields[place[0]].is_required() or (node is not None and node.content is not None):
            continue
        known = [*(texts.keys(place[0]) or ()), *(absent if path[:-1] == ("answers", "keys") else ())]
        meant = suggest(place[-1], known) if len(place) > 1 else ""
        yield protocol.problem(
            path,
            f"no text `{'.'.join(place)}` in {texts.source.path.name}, which this needs",
            "a text there" + (", or the words here" if place[0] == "further" else ""),
            f"did you mean '{meant}'? Else add it" if meant else "add it",
            at_key=path[-1] == place[-1],
        )


_ROOM, _ROOM_IN_WORDS, _LONGEST_WORD = 120, 78, 17
"""Largest number of letters on a row of buttons and of the longest words on them, and in a word: all labels of a row
have the size of the longest one, which would be too small to read."""
_BREAKS = re.compile(r"[^\S\u00a0\u202f]|[\u00ad\u200b]|[\u2e80-\uffef]")
"""Places where a line may break: spaces, soft hyphens, zero-width spaces, and ideographs."""


def _count(text: str) -> int:
    """Return the number of letters that take room: no vowel or tone mark above or below another, and no format mark."""
    return sum(unicodedata.category(letter)[0] != "M" and unicodedata.category(letter) != "Cf" for letter in text)


def check_labels(protocol: Reading[Protocol], texts: Reading[Texts]) -> Iterator[Problem]:
    """Yield a problem for each label too long for its button; for new files only, so that all records can be read."""
    offered = offered_answers(protocol)
    rows = [[answer.name for answer in offered if answer.is_below is below] for below in (False, True)]
    for questions in (("answers", "then"), ("form",)):
        rows += [list(question.keys) for _, question in protocol.items(*questions)]
    for name, n_beside in [(name, len(row)) for row in rows for name in row]:
        path = (name,) if name in SHIPPED else ("answers", name)
        label = str(texts.sound(*path) or "")
        length, room = max(map(_count, _BREAKS.split(label))), min(_LONGEST_WORD, _ROOM_IN_WORDS // n_beside)
        yield from texts.faults(
            (
                _count(label) > _ROOM // n_beside,
                path,
                f"{_count(label)} letters on a button",
                f"at most {_ROOM // n_beside} with {n_beside} answers in a row",
                "shorten it",
            ),
            (
                length > room,
                path,
                f"a word of {length} letters on a button",
                f"at most {room} with {n_beside} answers in a row",
                "shorten it, or write a soft hyphen (U+00AD) or zero-width space (U+200B) where it may break",
            ),
        )
