"""One view in each medium: what is bold, coloured, listed or left out, and names that no cell can break."""

from fidpipe.pipeline.report.page.page_templates import _environment
from fidpipe.pipeline.report.view import Answers, Note, Table, shortened
from reports import text_of

TABLE = Table(
    "Scores",
    ("pair", "CDC", "verdict", "p\nvalue"),
    [("[bold]a|b", 0.51249, "worse", None), ("x" * 60, 0.25, "same", 0.5)],
    words=(0, 2),
    digits=2,
    wide=(3,),
)
VIEW = [
    Note("worse: CDC", "bold red"),
    TABLE,
    Note("plain"),
    Note("note: one", "yellow"),
    Note("note: two", "yellow"),
]


def test_a_terminal_hides_wide_columns_shortens_words_and_colours_verdicts():
    text = text_of(VIEW, 40)
    assert max(map(len, text.splitlines())) <= 40
    assert "[bold]a|b" in text
    assert "0.51 " in text
    assert "value" not in text
    assert "…" in text
    assert "x" * 60 in text_of(VIEW, 120)
    assert "\x1b[31mworse" in text_of(VIEW, force_terminal=True, color_system="standard")


def test_words_to_be_typed_stay_whole_in_80_columns():
    setting = "dropoff_intensity_limit"
    rows = [("a cause of many words " * 3, "15 cm to 18 cm", "at most 20 %", setting)]
    text = text_of(
        [
            Table(
                "",
                ("cause", "95 % interval", "gain if corrected", "setting"),
                rows,
                range(4),
                whole=(3,),
            )
        ]
    )
    assert set(setting.split()) <= set(text.split())
    assert max(map(len, text.splitlines())) <= 80


def test_a_page_has_every_column_and_no_name_as_markup():
    template = _environment().from_string(
        '{% from "tables.html" import view %}{{ view(parts) }}'
    )
    page = template.render(parts=[Table("<b>", ("pair", "n"), [("<i>", 1)]), *VIEW[1:]])
    assert "&lt;b&gt;" in page
    assert "<i>" not in page
    assert '<td class="text worse" title="worse">worse</td>' in page
    assert "<td>0.50</td>" in page
    assert '<p class="note">note: one</p>' in page


def test_answers_stand_by_their_headings():
    answers = [
        Answers({"Next": [("go", "", "")], "Fix first": [("1  a", "b", "c"), ("2  d", "", "")]})
    ]
    assert text_of(answers).splitlines()[0] == "Next          go"


def test_short_names_stay_as_they_are_and_shortened_ones_differ():
    assert shortened(["000", "001"], 8) == {"000": "000", "001": "001"}
    names = [f"{'x' * 30}{i}{'y' * 30}" for i in range(3)]
    short = shortened(names, 8)
    assert len(set(short.values())) == 3
    assert all(len(own) < 61 for own in short.values())
