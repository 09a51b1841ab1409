from kinfeas.core.metrics import Share
from kinfeas.viz.report import Picture, Report, Row, to_html

FIGURES = {"within_5cm": 0.9, "ik_failures_per_episode": 1.5, "mean_deviation_m": 0.002}
REPORT = Report(
    title="PR2 <on> ggr",
    summary="It does.",
    rows=[
        Row("<policy>", Share(0.91, 0.88, 0.93), FIGURES, ours=True),
        Row("paper", Share(0.902, 0.902, 0.902), {}),
    ],
    notes=["A note."],
    pictures=[Picture("A picture.", b"\x89PNG...")],
    commands=["kinfeas demo --robot 'a & b'"],
)


def test_the_page_shows_the_results_and_escapes_text():
    page = to_html(REPORT)
    for text in ("91.0%", "88.0% &ndash; 93.0%", "2.0 mm", "1.50", "A note.", "A picture."):
        assert text in page
    assert "90.2% &ndash;" not in page  # the paper gives no interval
    assert page.count("PR2 &lt;on&gt; ggr") == 2
    assert "&lt;policy&gt;" in page
    assert "a &amp; b" in page
