from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from modaltouch.analysis.counts import count_answers
from modaltouch.analysis.csv_table import TableFormat
from modaltouch.analysis.designs import analyse_design
from modaltouch.analysis.parts import analyse_parts
from modaltouch.analysis.pipeline import read_responses
from modaltouch.protocol import AnswerList, Findings, InputError

PAPER = "differentiated_stimulation.yaml"
HEADER = "participant,finger_condition,zone_left,zone_right,velocity_mm_s,response"


def counted(path):
    """Return the counts of a file, for comparison."""
    return count_answers(read_responses(path).frame).counts


def fails(path) -> list[str]:
    """Return the problems of a file as lines of text."""
    with pytest.raises(InputError) as caught:
        read_responses(path)
    return str(caught.value).splitlines()


class TestForms:
    """One table in several file formats gives the same counts."""

    @pytest.mark.parametrize(
        "dress",
        [
            lambda text: text.replace("\n", "\r\n"),
            lambda text: text.replace("\n", "\r"),
            lambda text: "\ufeff" + text,
            lambda text: text + "\n\n  \n",
            lambda text: "\n" + text,
            lambda text: text.replace(",", ";"),
            lambda text: text.replace(",", "\t"),
            lambda text: "sep=;\n" + text.replace(",", ";"),
            lambda text: '"sep=|"\r\n' + text.replace(",", "|"),
            lambda text: "sep=;\n" + text,
            lambda text: text.replace(",", ", "),
            lambda text: text.replace(",", ";").replace(";80;", ";80,0;"),
            lambda text: text.replace("A,C", '"A","C"'),
            lambda text: text.replace("\n", ",,\n"),
            lambda text: "\n".join([text.split("\n")[0], *sorted(text.split("\n")[1:])]),
        ],
        ids=["crlf", "cr", "bom", "blank-end", "blank-start", "semicolon", "tab", "named", "named-in-quotes",
             "wrongly-named", "spaces", "decimal-comma", "quotes", "empty-columns", "any-order"],
    )  # fmt: skip
    def test_a_table_is_read_in_any_usual_form(self, write_csv, paper_rows, dress) -> None:
        """Reference: the plain comma-separated form of the same synthetic answers."""
        plain = write_csv(paper_rows)
        other = plain.with_name("other.csv")
        other.write_bytes(dress(plain.read_text(encoding="utf-8")).encode("utf-8"))
        assert (counted(other) == counted(plain)).all()

    def test_counts_of_equal_answers_are_the_same_as_single_ones(self, write_csv, build) -> None:
        """Column n: two answers per cell as counts and as rows."""
        rows = build["random"](3, 1, repetitions=2)
        keys = list({tuple(v for k, v in row.items() if k != "repetition"): None for row in rows})
        plain = [tuple(v for k, v in row.items() if k != "repetition") for row in rows]
        names = HEADER.split(",")
        with_counts = [{**dict(zip(names, key, strict=True)), "n": plain.count(key)} for key in keys]
        assert (counted(write_csv(with_counts, "n.csv")) == counted(write_csv(rows))).all()

    def test_repetitions_need_no_number_if_cells_have_equally_many(self, write_csv, build) -> None:
        """The same synthetic answers with and without the column repetition give the same counts."""
        rows = build["random"](3, 1, repetitions=2)
        bare = [{k: v for k, v in row.items() if k != "repetition"} for row in rows]
        assert (counted(write_csv(bare, "bare.csv")) == counted(write_csv(rows))).all()

    def test_other_columns_are_kept(self, write_csv, paper_rows) -> None:
        """An extra column stays in the table."""
        frame = read_responses(write_csv([{**row, "mood": "fine"} for row in paper_rows])).frame
        assert set(frame["mood"]) == {"fine"}

    def test_practice_trials_are_excluded_and_listed(self, write_csv, paper_rows) -> None:
        """The column practice of a record's table: such rows are never analysed and never dropped silently."""
        rows = [{**row, "practice": 0} for row in paper_rows] + [{**paper_rows[0], "practice": 1}] * 3
        responses = read_responses(write_csv(rows))
        assert len(responses.frame) == 240
        assert [(item.reason, "3 rows" in item.source) for item in responses.left_out] == [("practice trials", True)]

    @pytest.mark.parametrize("name", ["excluded", "exclude", "withdrawn", "invalid"])
    def test_rows_marked_by_a_lab_are_excluded_and_listed(self, write_csv, paper_rows, name) -> None:
        """They may lack a level; a mark other than 0 or 1 is refused."""
        rows = [{**row, name: 0} for row in paper_rows]
        rows += [{**paper_rows[0], "velocity_mm_s": "", name: "yes"}] * 3
        responses = read_responses(write_csv(rows))
        assert len(responses.frame) == 240
        (left_out,) = responses.left_out
        assert (left_out.reason, "3 rows" in left_out.source) == (f"rows marked {name}", True)
        with pytest.raises(InputError, match=rf"{name}: given 'too slow'; allowed: 0 or 1"):
            read_responses(write_csv([*rows, {**paper_rows[0], name: "too slow"}]))

    @pytest.mark.parametrize(
        "keep",
        [
            lambda row: row["participant"] == "p01",
            lambda row: row["velocity_mm_s"] == 80,
            lambda row: row["finger_condition"] == "two_hands",
            lambda row: row["zone_left"] == "B",
        ],
        ids=["one-participant", "one-level", "one-condition", "one-pair"],
    )
    def test_a_small_design_is_counted(self, write_csv, paper_rows, keep) -> None:
        """One participant, level, finger condition or pair can be counted."""
        rows = [row for row in paper_rows if keep(row)]
        assert counted(write_csv(rows)).sum() == len(rows)

    def test_zones_levels_and_conditions_other_than_the_papers_are_read(self, write_csv, paper_rows) -> None:
        """No code depends on the paper's names."""
        rows = [
            {**row, "zone_left": f"zone {row['zone_left']}", "velocity_mm_s": row["velocity_mm_s"] / 7,
             "finger_condition": {"one_hand": "gloved", "two_hands": "bare"}[row["finger_condition"]]}
            for row in paper_rows
        ]  # fmt: skip
        answers = count_answers(read_responses(write_csv(rows)).frame)
        assert answers.finger_conditions == ("gloved", "bare")
        assert answers.levels == pytest.approx([80 / 7, 100 / 7, 150 / 7, 200 / 7])


class TestFaults:
    """Each fault gives its place, the value, what is allowed and a remedy; all faults are reported together."""

    def change(self, write_csv, rows, line: int, old: str, new: str):
        """Return the path of a table with one text changed in one line."""
        path = write_csv(rows)
        lines = path.read_text(encoding="utf-8").split("\n")
        assert old in lines[line - 1]
        lines[line - 1] = lines[line - 1].replace(old, new)
        path.write_text("\n".join(lines), encoding="utf-8")
        return path

    @pytest.mark.parametrize(
        ("old", "new", "words"),
        [
            (",both", ",middle", r":5:1: response: given 'middle'; allowed: left, right, both"),
            (",both", ",Both", r":5:1: response: given 'Both'; .*; write both, or map it"),
            (
                ",80,",
                ",8e-5,",
                r":5:1: velocity_mm_s: given '8e-5'; allowed: a peak velocity in mm/s, 0.001 to 100000",
            ),
            (",80,", ",fast,", r":5:1: velocity_mm_s: given 'fast'; allowed: a peak velocity in mm/s, 0.001 to 1"),
            (",80,", ",-80,", r"given '-80'"),
            (",80,", ",nan,", r"given 'nan'"),
            (",80,", ",inf,", r"given 'inf'"),
            (",80,", ',"80,5",', r"given '80,5'.*write a decimal point"),
            (",80,", ",80,5,", r":5:1: given 7 fields; allowed: 6 fields.*decimal comma"),
            ("p01,", ",", r":5:1: participant: given nothing"),
            ("B,D", "D,D", r"zone_right: given zone 'D' under both fingers"),
        ],
    )
    def test_a_faulty_field_is_reported_with_its_place(self, write_csv, paper_rows, old, new, words) -> None:
        """The fifth line is p01's first answer to (B, D) after sorting by pair."""
        rows = sorted(paper_rows, key=lambda row: (row["participant"], row["finger_condition"], row["velocity_mm_s"]))
        rows = [rows[0], rows[2], {**rows[0], "velocity_mm_s": 999}, {**rows[1], "response": "both"}, *rows]
        problems = fails(self.change(write_csv, rows, 5, old, new))
        assert any(re.search(words, problem) for problem in problems), problems

    def test_every_fault_is_reported_together(self, write_csv, paper_rows) -> None:
        """Three faults in three rows are three problems."""
        rows = [dict(row) for row in paper_rows]
        rows[0]["response"], rows[1]["velocity_mm_s"], rows[2]["participant"] = "up", "x", ""
        assert len(fails(write_csv(rows))) == 3

    def test_an_unknown_answer_in_all_rows_is_reported_once(self, write_csv, build) -> None:
        """One message covers 240 rows with the same unknown answer."""
        problems = fails(write_csv(build["constant"](response="nowhere")))
        assert len(problems) == 1
        assert "given 'nowhere' (in 240 rows)" in problems[0]

    def test_measured_levels_are_reported_once(self, write_csv, paper_rows) -> None:
        """If all levels differ, no row is missing; the message asks for the requested levels."""
        rows = [{**row, "velocity_mm_s": row["velocity_mm_s"] + number / 100} for number, row in enumerate(paper_rows)]
        (problem,) = fails(write_csv(rows))
        assert ":2:1: velocity_mm_s: given 80 (line 2), 80.01 (line 3), " in problem
        assert "and 237 more; allowed: the same for all participants" in problem
        assert "put measured levels into a column not named velocity_mm_s" in problem
        assert "add the missing rows" not in problem

    @pytest.mark.parametrize(
        ("column", "word", "words"),
        [
            (
                "velocity_mm_s",
                81,
                r":4:1: velocity_mm_s: given 81 \(line 4\), which fewer than half of the participants have",
            ),
            ("finger_condition", "one hand", r":4:1: finger_condition: given one hand \(line 4\), which fewer than"),
            (
                "zone_right",
                "B",
                r":4:1: zone_left: given C-B \(line 4\), which fewer than half of the participants have",
            ),
        ],
    )
    def test_a_mistyped_level_zone_or_condition_is_reported_where_it_is(
        self, write_csv, paper_rows, column, word, words
    ) -> None:
        """One row of 240 differs: nobody lacks a cell, so the message does not list all participants."""
        rows = [dict(row) for row in paper_rows]
        rows[2][column] = word
        (problem,) = fails(write_csv(rows))
        assert re.search(words, problem), problem

    def test_other_faults_are_reported_beside_a_mistyped_level(self, write_csv, build) -> None:
        """A repetition written twice is told at once, too."""
        rows = build["random"](3, 1)
        rows[2]["velocity_mm_s"] = 81
        level, again = fails(write_csv([*rows, rows[0]]))
        assert "velocity_mm_s: given 81 (line 4)" in level and "repetition 1 again (first on line 2)" in again

    def test_values_that_are_all_rare_are_not_listed(self, write_csv, paper_rows) -> None:
        """Three conditions between participants: each lacks cells, which is told, but no condition is mistyped."""
        names = ("one_hand", "two_hands", "feet")
        rows = [row for row in paper_rows[:108] if row["participant"] < "p10"]
        rows = [row | {"finger_condition": names[int(row["participant"][1:]) % 3]} for row in rows]
        assert all("no answer from participant p0" in problem for problem in fails(write_csv(rows)))

    def test_a_missing_column_is_reported_with_those_found(self, write_csv, paper_rows) -> None:
        """The most similar name is suggested, also if all names are capitalised."""
        rows = [{("velocity" if k == "velocity_mm_s" else k): v for k, v in row.items()} for row in paper_rows]
        (problem,) = fails(write_csv(rows))
        assert "velocity_mm_s: given columns participant" in problem
        assert "rename 'velocity'" in problem
        capitals = fails(write_csv([{key.title(): value for key, value in row.items()} for row in paper_rows]))
        assert (len(capitals), "rename 'Finger_Condition'" in capitals[0]) == (6, True)

    def test_a_table_without_a_header_shows_its_first_line(self, write_csv, paper_rows) -> None:
        """The first line of data is not a header."""
        path = write_csv(paper_rows)
        path.write_text(path.read_text(encoding="utf-8").split("\n", 1)[1], encoding="utf-8")
        (problem,) = fails(path)
        assert "given a first line 'p01,one_hand" in problem

    def test_a_column_given_twice_is_refused(self, write_csv, paper_rows) -> None:
        """It would be ambiguous which one counts."""
        path = write_csv([{**row, "note": 1} for row in paper_rows])
        path.write_text(path.read_text(encoding="utf-8").replace(",note", ",response", 1), encoding="utf-8")
        assert "2 columns named 'response'" in fails(path)[0]

    @pytest.mark.parametrize(
        ("content", "words"),
        [
            (b"", ": given an empty file"),
            (b"\n\n", ": given an empty file"),
            (HEADER.encode() + b"\n", "a header without any row"),
            (HEADER.encode() + b"\np\xe9,", ":2:2: given the byte 0xe9, which is not UTF-8"),
            ("\ufeff".encode("utf-16-le") + HEADER.encode("utf-16-le"), "text in UTF-16"),
            (b"PK\x03\x04\x00\x00", "a file that is not text"),
            (HEADER.encode() + b'\np1,"one_hand\n', "a line that is not CSV"),
        ],
    )
    def test_a_file_that_is_not_a_table_is_identified(self, tmp_path, content, words) -> None:
        """It is an input error, never a traceback."""
        path = tmp_path / "answers.csv"
        path.write_bytes(content)
        (problem,) = fails(path)
        assert words in problem

    def test_a_missing_file_is_reported(self, tmp_path) -> None:
        """The message says that there is no such file."""
        (problem,) = fails(tmp_path / "no.csv")
        assert "no such file or folder" in problem

    def test_a_mode_is_refused_for_a_table_without_one(self, write_csv, paper_rows) -> None:
        """A CSV need not state whether it is simulated."""
        with pytest.raises(InputError, match="given mode 'real' with a CSV file; allowed: a table with a column mode"):
            read_responses(write_csv(paper_rows), mode="real")


class TestBalance:
    def test_a_missing_answer_is_counted_with_participant_and_cell(self, write_csv, paper_rows) -> None:
        """With one of 240 rows removed, the others are analysed."""
        rows = [
            row
            for row in paper_rows
            if (row["participant"], row["finger_condition"], row["zone_left"], row["velocity_mm_s"])
            != ("p03", "one_hand", "A", 80)
        ]
        answers = read_responses(write_csv(rows)).count()
        assert answers.missing == [("p03", "one_hand A-C 80 mm/s", 1)]
        assert answers.counts.sum() == 239

    @pytest.mark.parametrize("word", ["", "n/a", "time_out", "NA"])
    def test_an_empty_response_is_a_missing_answer(self, write_csv, paper_rows, word) -> None:
        """An empty field, BIDS's n/a, the record's time_out, and any other word given as missing."""
        rows = [dict(row) for row in paper_rows]
        rows[5]["response"] = word
        responses = read_responses(write_csv(rows), table_format=TableFormat(missing=("NA",)))
        assert [n for *_, n in responses.count().missing] == [1]
        assert len(responses.frame) == 239

    def test_a_row_without_its_rating_is_a_missing_answer(self, write_csv, paper_rows) -> None:
        """The protocol asks for a number; the word in the column response alone is not an answer."""
        design = {"answers": {"scale": {"kind": "likert"}}}
        rows = [{**row, "response": "rated", "value": 3} for row in paper_rows]
        rows[5]["value"] = ""
        asked = TableFormat(answers=AnswerList.of(design["answers"]), design=design)
        assert [n for *_, n in read_responses(write_csv(rows), table_format=asked).count().missing] == [1]

    def test_a_cell_without_any_answer_is_missing(self, write_csv, paper_rows) -> None:
        """The design has every finger condition with every pair at every level."""
        rows = [row for row in paper_rows if (row["zone_left"], row["velocity_mm_s"]) != ("C", 200)]
        problems = fails(write_csv(rows))
        assert len(problems) == 10
        assert "one_hand C-E 200 mm/s, two_hands C-E 200 mm/s" in problems[0]

    def test_a_duplicate_row_is_reported_with_both_lines(self, write_csv, paper_rows) -> None:
        """The first row is repeated at the end, in line 242."""
        (problem,) = fails(write_csv([*paper_rows, paper_rows[0]]))
        assert ":242:" in problem
        assert "2 answers from participant p01 in one_hand A-C 80 mm/s (lines 2, 242)" in problem

    def test_a_duplicate_repetition_is_reported(self, write_csv, build) -> None:
        """The same participant, cell and repetition occur twice."""
        rows = build["random"](2, 1, repetitions=2)
        problems = fails(write_csv([*rows, rows[0]]))
        assert any("again (first on line 2)" in problem for problem in problems)

    def test_a_duplicate_count_is_reported(self, write_csv, paper_rows) -> None:
        """The same participant, cell and response are counted twice."""
        rows = [{**row, "n": 1} for row in paper_rows]
        problems = fails(write_csv([*rows, rows[0]]))
        assert any("again (first on line 2)" in problem for problem in problems)

    @pytest.mark.parametrize(
        ("n", "of"), [(1, "p01, with the same times, twice"), (0, "p99, .* identical to those of p01")]
    )
    def test_answers_copied_with_their_times_are_refused(self, write_csv, paper_rows, n, of) -> None:
        """A table pasted below itself, and one participant's rows under another id."""
        rows = [{**row, "response_time": 0.8 + place / 1000} for place, row in enumerate(paper_rows)]
        own = [{**row, "participant": "p99"} for row in rows if row["participant"] == "p01"]
        assert re.search(f"every answer of {of}", fails(write_csv([*rows, *(rows if n else own)]))[0])

    def test_trials_copied_with_their_numbers_are_refused(self, write_csv, paper_rows) -> None:
        """A table pasted below itself would double the answers and lower p; two sessions need session numbers."""
        rows = [{**row, "trial": place} for place, row in enumerate(paper_rows)]
        problems = fails(write_csv([*rows, *rows]))
        said = "trial: given participant p01, finger_condition one_hand, trial 0 again (first on line 2); allowed: one"
        assert "220 more duplicate rows" in problems[0] and said in problems[1]
        sessions = [{**row, "session": number} for number in (1, 2) for row in rows]
        assert len(read_responses(write_csv(sessions)).frame) == 2 * len(rows)

    def test_repeated_coarse_times_are_not_copies(self, write_csv, paper_rows) -> None:
        """Five repetitions timed to half a second: every row recurs, but not equally often."""
        rows = [
            {**row, "repetition": n + 1, "response_time": 0.5 * (1 + place % 7) + (0.5 if n < 3 else 4.5)}
            for place, row in enumerate(paper_rows)
            for n in range(5)
        ]
        assert len(read_responses(write_csv(rows)).frame) == len(rows)

    def test_names_that_differ_in_case_are_refused(self, write_csv, paper_rows) -> None:
        """A capitalised condition of one participant is not a cell that all others miss."""
        rows = [dict(row) for row in paper_rows]
        rows[-1]["finger_condition"] = "Two_hands"
        assert any("given 'Two_hands' beside 'two_hands'" in problem for problem in fails(write_csv(rows)))

    @pytest.mark.parametrize(
        ("times", "said"), [(1100, "divide times in milliseconds by 1000"), (-0.5, "allowed: 0 to 86400 s")]
    )
    def test_reaction_times_are_seconds(self, write_csv, paper_rows, times, said) -> None:
        """Times in milliseconds and negative times are refused."""
        assert said in fails(write_csv([{**row, "response_time": times} for row in paper_rows]))[0]

    @pytest.mark.parametrize("n", ["1.5", "-1", "x", "", "999999999"])
    def test_a_count_is_a_non_negative_integer(self, write_csv, paper_rows, n) -> None:
        """Counts start at 0."""
        rows = [{**row, "n": 1} for row in paper_rows]
        rows[4]["n"] = n
        assert any("allowed: a whole number, 0 to 100000" in problem for problem in fails(write_csv(rows)))

    def test_a_long_list_of_faulty_participants_is_shortened(self, write_csv, build) -> None:
        """Of forty participants without their last cell, twenty are listed and the rest counted."""
        rows = [
            row for row in build["paper"](80) if not (int(row["participant"][1:]) > 40 and row["velocity_mm_s"] == 80)
        ]
        problems = fails(write_csv(rows))
        assert len(problems) == 21
        assert any("20 more participants" in problem for problem in problems)


def test_a_condition_of_one_participant_of_two_is_missing_elsewhere(write_csv, build) -> None:
    """A misspelling in one of 48 rows makes cells that both participants miss; neither spelling is rarer in people."""
    rows = build["paper"](2)
    rows[47]["finger_condition"] = "2hands"
    found = fails(write_csv(rows))
    assert len(found) == 2
    assert all("2hands" in problem and "no answer from participant" in problem for problem in found)


def test_a_participant_who_stopped_early_is_reported(write_csv, build) -> None:
    """With three of 24 answers, cells are missing."""
    rows = [row for row in build["paper"](4) if row["participant"] != "p04"]
    rows += [row for row in build["paper"](4) if row["participant"] == "p04"][:3]
    (problem,) = fails(write_csv(rows))
    assert "no answer from participant p04 in" in problem


def test_a_condition_of_half_the_participants_is_missing_for_the_others(write_csv, build) -> None:
    """Five of ten never had two hands on the beam."""
    rows = [row for row in build["paper"](10) if row["participant"] < "p06" or row["finger_condition"] == "one_hand"]
    found = fails(write_csv(rows))
    assert len(found) == 5
    assert all("no answer from participant" in problem for problem in found)


@given(st.data())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_corrupted_table_is_refused_or_read(tmp_path, paper_csv, data) -> None:
    """With bytes removed, inserted or changed anywhere, the result is answers or an InputError with its places."""
    content = paper_csv.read_bytes()[:2000]
    pieces = [b"", b'"', b",", b"\n", b";", b"\x00", b"\xff", b"1e999", b"nan", b"\t", b"-"]
    for _ in range(data.draw(st.integers(1, 3))):
        at, cut = data.draw(st.integers(0, len(content))), data.draw(st.integers(0, 40))
        content = content[:at] + data.draw(st.sampled_from(pieces)) + content[at + cut :]
    path = tmp_path / "spoiled.csv"
    path.write_bytes(content)
    try:
        read = count_answers(read_responses(path).frame).counts.sum() > 0
    except InputError as error:
        read = all(str(problem).startswith(f"{path}:") for problem in error.problems)
    assert read


def in_multiples(rows):
    """Return the levels as multiples of a threshold, beside individual velocities."""
    return [
        row | {"multiple_of_threshold": row["velocity_mm_s"] / 100, "velocity_mm_s": row["velocity_mm_s"] + i % 10}
        for i, row in enumerate(rows)
    ]


def test_multiples_of_the_threshold_are_the_level_if_given(write_csv, paper_rows) -> None:
    """As in a record's table, with n/a in a catch trial; individual velocities would not form cells."""
    rows = [row | {"catch": 0} for row in in_multiples(paper_rows)]
    rows.append(rows[0] | {"catch": 1, "velocity_mm_s": 0, "multiple_of_threshold": "n/a"})
    responses = read_responses(write_csv(rows))
    answers = count_answers(responses.frame)
    assert answers.levels == (0.8, 1.0, 1.5, 2.0)
    assert answers.scale.unit == "x threshold"
    assert responses.caught("p01").total() == 1
    assert "velocity_mm_s" not in responses.frame


@pytest.mark.parametrize(
    ("word", "words"),
    [
        ("n/a", "given nothing; allowed: a multiple of the participant's own threshold, 0.001 to 100000"),
        ("-1", "a multiple of the participant's own threshold, 0.001 to 100000"),
        ("2 x", "a multiple of the participant's own threshold, 0.001 to 100000"),
        ("1.5", "2 answers from participant p01 in one_hand A-C 1.5 x threshold"),
        ("7", "multiple_of_threshold: given 7 (line 2), which fewer than half of the participants have"),
    ],
)
def test_a_faulty_multiple_is_reported_with_its_place(write_csv, paper_rows, word, words) -> None:
    """One faulty row: empty, negative, not a number, of another cell, or without a counterpart."""
    rows = in_multiples(paper_rows)
    rows[0] = rows[0] | {"multiple_of_threshold": word}
    told = fails(write_csv(rows))
    assert any(words in line for line in told), told


def test_answers_are_mapped_as_requested(write_csv, paper_rows) -> None:
    """L, B and R are mapped; the message on an unknown answer gives the option."""
    short = {"left": "L", "both": "B", "right": "R"}
    path = write_csv([row | {"response": short[row["response"]]} for row in paper_rows], "short.csv")
    read = read_responses(path, table_format=TableFormat(words={word: name for name, word in short.items()}))
    assert (read.count().counts == counted(write_csv(paper_rows))).all()
    assert all("--answers L=left,R=right" in problem and "--missing" in problem for problem in fails(path))


def test_an_answer_that_names_a_zone_is_to_name_the_finger(write_csv, paper_rows) -> None:
    """One zone is under the left finger in one pair and under the right one in another: no mapping is possible."""
    told = fails(write_csv([row | {"response": row["zone_left"]} for row in paper_rows]))
    assert all("write `left` or `right` for the finger on it" in problem for problem in told)


class TestSessionsAndModes:
    def test_several_modes_are_never_mixed(self, write_csv, paper_rows) -> None:
        """Real and simulated rows of the same cells are refused, unless one mode is chosen."""
        rows = [row | {"mode": mode} for mode in ("real", "simulated") for row in paper_rows]
        path = write_csv(rows)
        assert "rows of several words under mode (real, simulated)" in fails(path)[0]
        chosen = read_responses(path, mode="simulated")
        assert (chosen.source.mode, chosen.count().n_repetitions) == ("simulated", 1)

    def test_an_unknown_mode_in_a_table_is_refused(self, write_csv, paper_rows) -> None:
        """The mode is neither real nor pilot nor simulated."""
        assert "a column mode with fast" in fails(write_csv([row | {"mode": "fast"} for row in paper_rows]))[0]

    def test_several_stimuli_are_analysed_together_or_one_is_chosen(self, write_csv, paper_rows) -> None:
        """As with recorded sessions, each stimulus is a part with its own counts; one answer is missing."""
        rows = [row | {"stimulus": name} for name in ("near", "far") for row in paper_rows]
        path = write_csv(rows[:-1])
        assert read_responses(path, stimulus="near").count().n_repetitions == 1
        found = analyse_parts(read_responses(path))
        assert [part.factors for part in found.parts] == [{"stimulus": "far"}, {"stimulus": "near"}]
        assert (found.parts[1].counts.counts == counted(write_csv(paper_rows, "alone.csv"))).all()
        assert [missing["n"] for missing in found.as_dict()["missing"]] == [1]

    def test_stimuli_and_groups_are_in_the_order_of_the_protocol(self, write_csv, paper_rows) -> None:
        """Differences are the first minus the second: in the protocol's order, or alphabetical without a protocol."""
        rows = [row | {"stimulus": name, "group": "old" if row["participant"] < "p05" else "new"}
                for name in ("near", "far") for row in paper_rows]  # fmt: skip
        path = write_csv(rows)
        assert read_responses(path).stimuli == ("far", "near")
        design = {"stimuli": {"near": {}, "far": {}}, "groups": {"old": {}, "new": {}}}
        read = read_responses(path, table_format=TableFormat(design=design))
        assert (read.stimuli, [*dict.fromkeys(read.groups.values())]) == (("near", "far"), ["old", "new"])
        alone = read_responses(path, stimulus="far", table_format=TableFormat(design=design))
        assert [*dict.fromkeys(alone.groups.values())] == ["old", "new"]

    def test_kinds_of_session_are_separate_as_in_a_results_folder(self, write_csv, paper_rows) -> None:
        """Each kind has the counts of the paper's table; training is excluded, and the order is the protocol's."""
        sessions = [{"name": "pre"}, {"name": "training", "analysed": False}, {"name": "post"}]
        rows = [
            row | {"session_kind": kind["name"], "session": number}
            for number, kind in enumerate(sessions)
            for row in paper_rows
        ]
        path, design = write_csv(rows), {"schedule": {"sessions": sessions}}
        read = read_responses(path, table_format=TableFormat(design=design))
        assert read.kinds == ("pre", "post") and not read.notes
        assert "of a kind of session that is not analysed" in read.left_out[0].reason
        for part in analyse_parts(read).parts:
            assert (part.counts.counts == counted(write_csv(paper_rows, "alone.csv"))).all()
        assert read_responses(path).kinds == ("post", "pre", "training")

    def test_a_row_without_a_stimulus_is_refused_if_others_have_one(self, write_csv, paper_rows) -> None:
        """The fault has its line; catch and practice trials need no stimulus, nor does a table with an empty column."""
        rows = [row | {"stimulus": name, "catch": 0} for name in ("near", "far") for row in paper_rows]
        silent = rows[0] | {"stimulus": "", "catch": 1}
        (problem,) = fails(write_csv([silent, *rows[:7], rows[7] | {"stimulus": ""}, *rows[8:]]))
        assert ":10:" in problem
        assert "stimulus: given nothing; allowed: the name of a stimulus in every row; fill it in" in problem
        assert len(read_responses(write_csv([silent, *rows])).stimuli) == 2
        assert read_responses(write_csv([row | {"stimulus": ""} for row in paper_rows])).stimuli == ()

    def test_sessions_are_noted_as_repetitions(self, write_csv, paper_rows) -> None:
        """Every participant has two sessions."""
        read = read_responses(write_csv([row | {"session": number} for number in (1, 2) for row in paper_rows]))
        assert read.count().n_repetitions == 2
        assert read.notes == ("2 sessions of each participant taken together, as repetitions",)

    def test_a_session_that_others_do_not_have_is_excluded(self, write_csv, paper_rows) -> None:
        """One participant has two sessions: the second is listed and left out."""
        again = [row | {"session": 2} for row in paper_rows if row["participant"] == "p01"]
        read = read_responses(write_csv([*(row | {"session": 1} for row in paper_rows), *again]))
        assert read.count().n_repetitions == 1
        assert [item.reason for item in read.left_out] == ["sessions after number 1: not every participant has more"]


def test_a_table_of_adaptive_levels_is_refused(write_csv, paper_rows) -> None:
    """Its levels are not cells, and its rows do not identify the runs."""
    design = {"adaptive": {"method": "staircase"}}
    with pytest.raises(InputError, match="a table with an adaptive protocol.*give the folder of the sessions"):
        read_responses(write_csv(paper_rows), table_format=TableFormat(design=design))


PROTOCOL = {
    "answers": {"scale": {"kind": "vas"}, "then": {"sure": {"scale": {"kind": "likert", "highest": 4}}}},
    "stimuli": {"near": {}, "far": {}},
    "groups": {"old": {}, "new": {}},
    "schedule": {"sessions": [{"name": "pre"}, {"name": "post"}]},
}


@pytest.mark.parametrize(
    ("column", "word", "fault"),
    [
        ("value", "190", "given '190'; allowed: 0 to 100 by 1, or nothing"),
        ("sure", "0", "given '0'; allowed: 1 to 4 by 1, or nothing"),
        ("stimulus", "nera", "given 'nera'; allowed: near, far; write one of them"),
        ("group", "od", "given 'od'; allowed: old, new; write one of them"),
        ("session_kind", "p", "given 'p'; allowed: pre, post; write one of them"),
        ("group", "new", "given 'new' of participant p01, who was in another group before; allowed: one group of each"),
    ],
)
def test_a_table_is_checked_against_its_protocol(write_csv, paper_rows, column, word, fault) -> None:
    """A rating outside its scale, an unknown name, a participant in two groups: each is reported with its line."""
    usual = {"value": 50, "sure": 2, "stimulus": "near", "group": "old", "session_kind": "pre", "response": "rated"}
    rows = [row | usual for row in paper_rows]
    rows[5][column] = word
    answers = AnswerList.of(PROTOCOL["answers"])
    with pytest.raises(InputError) as caught:
        read_responses(write_csv(rows), table_format=TableFormat(answers, design=PROTOCOL))
    assert f": {column}: {fault}" in str(caught.value) and ":7:" in str(caught.value)


def test_a_time_out_is_not_a_rating(write_csv, paper_rows) -> None:
    """It may be written as in a record's table, or left empty; neither is refused."""
    design = {"answers": PROTOCOL["answers"]}
    rows = [row | {"value": 50, "sure": sure, "response": "rated"} for row, sure in zip(
        paper_rows, ["time_out", "", *[3] * len(paper_rows)], strict=False)]  # fmt: skip
    read = read_responses(write_csv(rows), table_format=TableFormat(AnswerList.of(design["answers"]), design=design))
    assert read.frame["sure"].isna().sum() == 2 and read.frame["sure"].max() == 3


def test_an_unknown_further_answer_is_not_taken_as_missing(write_csv, paper_rows) -> None:
    """A misspelling is refused with its line; a missing mark, a time-out and an empty field are missing."""
    design = {"answers": {**PROTOCOL["answers"], "then": {"feel": {"keys": {"smooth": ["f1"], "rough": ["f2"]}}}}}
    form = TableFormat(AnswerList.of(design["answers"]), missing=("NA",), design=design)
    rows = [row | {"value": 50, "response": "rated", "feel": "rough"} for row in paper_rows]
    for row, word in zip(rows, ("NA", "time_out", ""), strict=False):
        row["feel"] = word
    read = read_responses(write_csv(rows), table_format=form)
    assert (read.frame["feel"].isna().sum(), (read.frame["feel"] == "rough").sum()) == (3, len(rows) - 3)
    said = f"Of {len(rows)} answers to feel, 3 are missing: its results are those of the others."
    assert said in analyse_design(read).limits
    rows[5]["feel"] = "smoth"
    with pytest.raises(InputError, match=":7:.*feel: given 'smoth'; allowed: smooth, rough; write smooth, or leave it"):
        read_responses(write_csv(rows), table_format=form)


def test_the_focus_of_a_table_comes_from_the_protocol(write_csv, paper_rows) -> None:
    """Each of several stimuli has its own focus; without a protocol it is unknown."""
    design = {"stimulus": {"focus": "C"}, "stimuli": {"near": {"focus": "B"}, "far": {}}}
    path = write_csv([row | {"stimulus": name} for name in ("near", "far") for row in paper_rows])
    foci = [
        read_responses(path, stimulus=name, table_format=TableFormat(design=design)).focus for name in design["stimuli"]
    ]
    assert (foci, read_responses(path, stimulus="far").focus) == (["B", "C"], "")


def test_a_table_of_an_uncrossed_design_is_analysed_in_parts(write_csv, build) -> None:
    """Each pair has its own level: two parts; a trial without a row is refused with the remedy."""
    levels = {"A": 80, "B": 150}
    rows = [row for row in build["random"](6, 1) if levels.get(row["zone_left"]) == row["velocity_mm_s"]]
    design = {"conditions": {"exclude": [{"pair": ["A", "C"]}]}, "stimulus": {"focus": "C"}}
    found = analyse_parts(read_responses(write_csv(rows), table_format=TableFormat(design=design)))
    assert sorted(part.name.split(" ", 3)[3] for part in found.parts) == ["A-C at 80 mm/s", "B-D at 150 mm/s"]
    assert {part.counts.n_participants for part in found.parts} == {6} and found.parts[0].counts.pairs[0].focused
    with pytest.raises(
        InputError, match="unequally often.*give every trial a row, with an empty response where none was given"
    ):
        analyse_parts(read_responses(write_csv(rows[1:], "less.csv"), table_format=TableFormat(design=design)))


@pytest.mark.parametrize(
    ("change", "crossed"), [("", True), ("weight: 2, ", False), ("finger_conditions: [one_hand], ", False)]
)
def test_cells_that_list_a_crossed_design_are_analysed_as_crossed(write_csv, paper_rows, edit, change, crossed) -> None:
    """One line per pair, with every level: Fig. 10 as from zone_pairs; with a weight of one pair there are parts."""
    pairs, levels = ("[A, C]", "[B, D]", "[C, E]"), "peak_velocities_mm_s: [80, 100, 150, 200]"
    cells = ", ".join(f"{{{change * (pair == '[B, D]')}pair: {pair}, {levels}}}" for pair in pairs)
    listed = (f"  zone_pairs: [{', '.join(pairs)}]\n  {levels}\n", f"  cells: [{cells}]\n")
    form = TableFormat.of(Findings.read(edit(PAPER, listed)))
    found = read_responses(write_csv(paper_rows), table_format=form)
    assert (found.scheduled is None) == crossed


@pytest.mark.parametrize("column", ["value", "sure", "stimulus", "group", "session_kind"])
def test_a_table_has_the_columns_of_its_protocol(write_csv, paper_rows, column) -> None:
    """Otherwise stimuli, groups and kinds of session would be pooled, and ratings left out, silently."""
    usual = {"value": 50, "sure": 2, "stimulus": "near", "group": "old", "session_kind": "pre", "response": "rated"}
    del usual[column]
    answers = AnswerList.of(PROTOCOL["answers"])
    with pytest.raises(InputError, match=f"{column}: given columns participant.*; add the column {column}"):
        read_responses(
            write_csv([row | usual for row in paper_rows]), table_format=TableFormat(answers, design=PROTOCOL)
        )


def test_a_mark_for_missing_answers_applies_to_ratings(write_csv, paper_rows) -> None:
    """A rating of -99 is outside the scale unless it is given as a mark for missing."""
    design = {"answers": {"scale": {"kind": "likert"}}}
    answers = AnswerList.of(design["answers"])
    rows = [row | {"response": "rated", "value": 4} for row in paper_rows]
    path = write_csv([rows[0] | {"value": -99}, *rows[1:]])
    with pytest.raises(InputError, match="value: given '-99'; allowed: 1 to 7 by 1, or nothing"):
        read_responses(path, table_format=TableFormat(answers, design=design))
    read = read_responses(path, table_format=TableFormat(answers, missing=("-99",), design=design))
    assert (len(read.frame), read.frame["value"].min()) == (len(rows) - 1, 4)


@pytest.mark.parametrize("left_out", [{"response": ""}, {"response": "n/a"}, {}])
def test_ratings_need_no_response_column(write_csv, paper_rows, left_out) -> None:
    """Reference: the same numbers with the record's response; a row without a number has no answer."""
    design = {"answers": {"scale": {"kind": "likert"}}}
    form = TableFormat(AnswerList.of(design["answers"]), design=design)
    rows = [row | {"value": 1 + place % 7 if place else ""} for place, row in enumerate(paper_rows)]
    told = write_csv([row | {"response": "rated"} for row in rows])
    bare = write_csv([{k: v for k, v in row.items() if k != "response"} | left_out for row in rows], "bare.csv")
    expected, found = (read_responses(path, table_format=form).frame for path in (told, bare))
    assert len(found) == len(rows) - 1 and found["value"].tolist() == expected["value"].tolist()
    assert set(found["response"]) == {"rated"}


def test_a_level_of_zero_is_identified_as_a_catch_trial(write_csv, paper_rows) -> None:
    """A record's table has such levels; here its column `catch` was lost."""
    with pytest.raises(InputError, match=r"given '0'; allowed: .*; mark catch trials by a 1 in a column `catch`"):
        read_responses(write_csv([*paper_rows, paper_rows[0] | {"velocity_mm_s": 0}]))


def test_participants_and_levels_without_any_answer_are_listed(write_csv, paper_rows) -> None:
    """Neither p03 nor 80 mm/s is in any result, so a note is needed; a table without any answer is refused."""
    gone = [row | {"response": "time_out"} if row["participant"] == "p03" else row for row in paper_rows]
    (note,) = read_responses(write_csv(gone)).notes
    assert note == "Left out, since there is no answer at all: participant p03"
    late = [row | {"response": ""} if float(row["velocity_mm_s"]) == 80 else row for row in paper_rows]
    (note,) = read_responses(write_csv(late)).notes
    assert note == "Left out, since there is no answer at all: 80 mm/s"
    with pytest.raises(InputError, match="no answer to any trial"):
        read_responses(write_csv([row | {"response": ""} for row in paper_rows]))


@pytest.mark.parametrize("times", [1, 2])
def test_a_table_with_all_rows_excluded_has_no_answers(write_csv, paper_rows, times) -> None:
    """The column may have been meant to mark the rows to keep."""
    with pytest.raises(InputError, match="given no answers; allowed: at least one answer that is not practice"):
        read_responses(write_csv([row | {"excluded": 1} for row in paper_rows * times]))


@pytest.mark.parametrize(
    "paste",
    [
        lambda rows: rows * 2,
        lambda rows: rows * 3,
        lambda rows: [row for row in rows for _ in range(2)],
        lambda rows: sorted(rows * 2, key=lambda row: row["velocity_mm_s"]),
        lambda rows: sorted(rows * 2, key=lambda row: [*row.values()]),
        lambda rows: [row | {"number": place} for place, row in enumerate(rows) for _ in range(2)],
        lambda rows: rows + rows[:-1],
    ],
    ids=["below", "thrice", "joined", "by-level", "by-every-column", "by-a-running-number", "but-one"],
)
def test_a_table_whose_every_row_recurs_is_refused(write_csv, paper_rows, paste) -> None:
    """It may be pasted together, whatever its order; repetitions that say so by numbers are read."""
    said = "every row [23] times; allowed: each once, or repetitions with numbers under `repetition`; remove the copies"
    with pytest.raises(InputError, match=said):
        read_responses(write_csv(paste(paper_rows)))
    numbered = [{**row, "repetition": number} for number in (1, 2) for row in paper_rows]
    assert len(read_responses(write_csv(numbered)).frame) == 480


@pytest.mark.parametrize(
    ("schedule", "most"),
    [
        ("repetitions: 1", 1),
        ("repetitions: 2", 2),
        ("repetitions: 1\n  sessions: 2", 2),
        ("repetitions: 1\n  sessions: [{name: training, analysed: false}, {name: test, times: 2}]", 2),
    ],
)
def test_more_copies_of_a_table_than_planned_repetitions_are_refused(
    write_csv, paper_rows, edit, schedule: str, most: int
) -> None:
    """Up to the number of answers in all analysed sessions, copies are read."""
    form = TableFormat.of(Findings.read(edit(PAPER, ("repetitions: 1", schedule))))
    assert form.most == most
    rows = [row | {"session_kind": "test"} for row in paper_rows]
    said = f"every row {most + 1} times, which gives {most + 1} answers .*; allowed: {most}, as in the protocol"
    with pytest.raises(InputError, match=said):
        read_responses(write_csv(rows * (most + 1)), table_format=form)
    assert len(read_responses(write_csv(rows * most), table_format=form).frame) == most * len(rows)


def test_more_copies_than_the_weights_of_the_cells_are_refused(write_csv, edit) -> None:
    """Pairs of weight 2 and 1, each given twice: four answers where two are planned."""
    cells = ("  zone_pairs: [[A, C], [B, D], [C, E]]\n  peak_velocities_mm_s: [80, 100, 150, 200]\n",
             "  cells: [{pair: [A, C], peak_velocities_mm_s: [80, 200], weight: 2}, "
             "{pair: [B, D], peak_velocities_mm_s: [100]}]\n")  # fmt: skip
    form = TableFormat.of(Findings.read(edit(PAPER, cells)))
    rows = [
        {"participant": who, "finger_condition": fingers, "zone_left": pair[0], "zone_right": pair[1],
         "velocity_mm_s": level, "response": "both"}
        for who in ("p1", "p2") for fingers in ("one_hand", "two_hands")
        for pair, level in [("AC", 80), ("AC", 80), ("AC", 200), ("AC", 200), ("BD", 100)]
    ]  # fmt: skip
    assert len(read_responses(write_csv(rows), table_format=form).frame) == 20
    with pytest.raises(InputError, match="gives 4 answers of a participant in a cell; allowed: 2, as in the protocol"):
        read_responses(write_csv(rows * 2), table_format=form)


def test_a_small_table_pasted_twice_is_refused_although_a_row_was_lost(write_csv, paper_rows) -> None:
    """All of twelve distinct rows but one occur twice; two answers to a cell may differ by chance, one row cannot."""
    rows = [row for row in paper_rows if (row["participant"], row["finger_condition"]) == ("p01", "one_hand")]
    assert len(rows) == 12
    with pytest.raises(InputError, match="given nearly every row 2 times; allowed: each once"):
        read_responses(write_csv([*rows, *rows[1:]]))
    other = {**rows[0], "response": "both"}
    assert len(read_responses(write_csv([*rows, other, *rows[1:]])).frame) == 24


def test_two_people_of_one_name_are_refused(write_csv, build) -> None:
    """Known: two labs' tables, each with p01 to p03, pasted together; trial 1 of p01 has two answers.

    Trials numbered anew in each finger condition, session or repetition are distinct.
    """
    rows = [
        {k: v for k, v in row.items() if k != "repetition"} | {"trial": number, "lab": lab}
        for lab, seed in (("Ulm", 1), ("Oslo", 2))
        for number, row in enumerate(build["random"](3, seed), start=1)
    ]
    bare = [{k: v for k, v in row.items() if k != "lab"} for row in rows]
    said = "trial: given participant p01, .*trial 1 again .first on line 2.; .*number .* sessions, and give two people"
    for each in (rows, bare):
        with pytest.raises(InputError, match=said):
            read_responses(write_csv(each))
    numbered = [row | {"session": place // 72} for place, row in enumerate(bare)]
    assert len(read_responses(write_csv(numbered)).frame) == 144
    named = [row | {"participant": f"{row['participant']} {row.pop('lab')}"} for row in rows]
    assert read_responses(write_csv(named)).frame["participant"].nunique() == 6


@pytest.mark.parametrize(
    "by",
    [
        ("zone_left",),
        ("finger_condition", "zone_left", "velocity_mm_s"),
        ("finger_condition",),
        ("day",),
        ("run", "day"),
    ],
)
def test_trials_may_be_numbered_anew(write_csv, build, by) -> None:
    """Each participant's trials are distinct within each pair, cell, day or run, so nobody is two people."""
    rows, numbers = [], Counter[tuple[str, ...]]()
    for place, row in enumerate(build["random"](3, 1, repetitions=4)):
        row = {k: v for k, v in row.items() if k != "repetition"} | {"day": place % 2, "run": place // 2 % 2}
        key = (row["participant"], *(str(row[name]) for name in by))
        numbers[key] += 1
        rows.append(row | {"trial": numbers[key]})
    assert len(read_responses(write_csv(rows)).frame) == 288


def test_a_trial_number_written_twice_is_no_second_person(write_csv, paper_rows) -> None:
    """One mistyped number among 240 leaves the answers as they are."""
    rows = [{**row, "trial": max(place, 1)} for place, row in enumerate(paper_rows)]
    assert len(read_responses(write_csv(rows)).frame) == 240


def test_a_participant_may_answer_in_two_labs(write_csv, paper_rows) -> None:
    """A crossover, a gap and a column of another meaning: nothing is computed from the column."""
    for names in (("Ulm", "Oslo"), ("", "Ulm")):
        rows = [row | {"lab": names[place % 2]} for place, row in enumerate(paper_rows)]
        assert len(read_responses(write_csv(rows)).frame) == 240


def test_a_count_table_may_have_two_words_for_no_answer(write_csv, build) -> None:
    """Both are missing answers, so they are no duplicate rows."""
    rows = [row | {"n": 2} for row in build["paper"](3)]
    rows[0]["n"] = 0
    rows += [rows[0] | {"response": word, "n": 1} for word in ("time_out", "n/a")]
    assert read_responses(write_csv(rows)).frame["n"].sum() == 142


def test_slow_participants_answer_in_seconds(write_csv, paper_rows) -> None:
    """Medians of 70 s beside 2 s are not milliseconds, and an excluded trial of 95 s has no part in them."""
    rows = [row | {"response_time": 70 if row["participant"] == "p03" else 2, "excluded": 0} for row in paper_rows]
    rows.append(rows[0] | {"participant": "p99", "response_time": 250, "excluded": 1})
    assert len(read_responses(write_csv(rows)).frame) == 240


def test_catch_trials_do_not_hide_a_doubled_table(write_csv, paper_rows) -> None:
    """Rows that do not count, each there once, are left aside."""
    asked = [row | {"catch": 0} for row in paper_rows]
    caught = [row | {"participant": f"c{place}", "catch": 1} for place in range(30) for row in asked[:1]]
    with pytest.raises(InputError, match="given every row 2 times; allowed: each once"):
        read_responses(write_csv([*asked, *asked, *caught]))


def test_times_of_one_participant_in_milliseconds_are_refused(write_csv, paper_rows) -> None:
    """Those of the other nine, in seconds, hide them in the median of all."""
    rows = [row | {"response_time": 800 if row["participant"] == "p03" else 0.8} for row in paper_rows]
    with pytest.raises(InputError, match="given a median time of 800 s from participant p03; allowed: seconds"):
        read_responses(write_csv(rows))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda row: row | {"zone_left": row["zone_right"], "zone_right": row["zone_left"]},
         "zone_left: given 'C-A' .in 80 rows.; allowed: A-C, B-D, C-E; write them as the protocol does"),
        (lambda row: row | {"velocity_mm_s": 10 * row["velocity_mm_s"]},
         "velocity_mm_s: given '800' .in 60 rows.; allowed: 80, 100, 150, 200;"),
        (lambda row: row | {"finger_condition": row["finger_condition"].replace("_", " ")},
         "finger_condition: given 'one hand' .in 120 rows.; allowed: one_hand, two_hands;"),
    ],
)  # fmt: skip
def test_cells_that_the_protocol_does_not_have_are_refused(write_csv, paper_rows, edit, change, words: str) -> None:
    """With swapped columns, every answer `left` would name the other zone; the counts look as good as the true ones."""
    form = TableFormat.of(Findings.read(edit(PAPER)))
    assert len(read_responses(write_csv(paper_rows), table_format=form).frame) == 240
    with pytest.raises(InputError, match=words):
        read_responses(write_csv([change(row) for row in paper_rows]), table_format=form)


@pytest.mark.parametrize(
    ("multiple", "words"), [(20, "multiple_of_threshold: given '20' .in 80 rows.; allowed: 1, 1.5, 2, 3;"), (2, "")]
)
def test_multiples_that_the_protocol_does_not_have_are_refused(write_csv, build, edit, multiple, words) -> None:
    """A decimal point was lost; levels in mm/s are each participant's own."""
    form = TableFormat.of(Findings.read(edit("sensation_levels.yaml")))
    conditions, pairs = form.design["conditions"]["finger_conditions"], [cell[2] for cell in form.planned]
    rows = [
        {"participant": who, "finger_condition": condition, "zone_left": left, "zone_right": right}
        | {"velocity_mm_s": 30 * level, "multiple_of_threshold": multiple if level == 2 else level, "response": "both"}
        for who in ("p1", "p2") for condition in conditions for left, right in dict.fromkeys(pairs)
        for level in (1, 1.5, 2, 3)
    ]  # fmt: skip
    if words:
        with pytest.raises(InputError, match=words.replace("80", str(len(rows) // 4))):
            read_responses(write_csv(rows), table_format=form)
    own = [{k: v for k, v in row.items() if k != "multiple_of_threshold"} for row in rows]
    for sound in (own, rows)[: 1 if words else 2]:
        assert len(read_responses(write_csv(sound), table_format=form).frame) == len(rows)


def test_levels_in_metres_per_second_are_refused(write_csv, paper_rows, edit) -> None:
    """Levels all below 1 mm/s are refused, unless the protocol has such levels."""
    path = write_csv([{**row, "velocity_mm_s": float(row["velocity_mm_s"]) / 1000} for row in paper_rows])
    said = "velocity_mm_s: given levels of at most 0.2; allowed: peak velocities in mm/s; multiply them by 1000"
    with pytest.raises(InputError, match=said):
        read_responses(path)
    form = TableFormat.of(Findings.read(edit(PAPER)))
    slow = Counter({(*cell, level / 1000, stimulus): n for (*cell, level, stimulus), n in form.planned.items()})
    planned = replace(form, planned=slow)
    assert read_responses(path, table_format=planned).frame["velocity_mm_s"].max() == 0.2
    with pytest.raises(InputError, match=f"{said} if they are in m/s$"):
        read_responses(path, table_format=form)


def test_the_session_number_is_not_suggested_as_its_kind(write_csv, paper_rows) -> None:
    """`session` has its own meaning, so the message does not suggest renaming it."""
    rows = [{**row, "session": "1"} for row in paper_rows]
    design = {"schedule": {"sessions": [{"name": "pre"}, {"name": "post"}]}}
    with pytest.raises(InputError, match="add the column session_kind"):
        read_responses(write_csv(rows), table_format=TableFormat(design=design))
