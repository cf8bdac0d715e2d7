"""The study of locking: its tasks, and gates that a reference of linear tets fails."""

from softdeca.benchmarks.harness import Row
from softdeca.benchmarks.studies.mesh.locking import FREE, LOCKS, MIRRORED, PRISMS, TWO_MESHES, Locking


def row(case, method, *lines):
    return Row(case, method, "done", "", {"rows": list(lines)}, 1.0, None, 0.0, "")


def line(what, mean, over_all=1.0):
    return {"what": what, "mean": mean, "max": 1.0, "over_all": over_all, "reference": "P2"}


def rows(*, lowest=1.0, highest=6.9, linear=0.018, free_linear=0.01, free_quadratic=0.001):
    return [
        row("level 1, nu 0.38", PRISMS, line("P1, 1 sub-layer", linear, lowest)),
        row("level 1, nu 0.45", PRISMS, line("P1, 1 sub-layer", linear, lowest)),
        row("level 1, nu 0.499", PRISMS, line("P1, 1 sub-layer", linear, highest)),
        row("level 1, nu 0.45", FREE, line("P1", free_linear), line("P2", free_quadratic)),
    ]


def passed(rows):
    return [gate["passed"] for gate in Locking().gates(rows)]


def test_every_case_is_a_task_of_its_own():
    tasks = Locking(poisson=("0.45", "0.499"), finer=("0.45",), free=("0.45",)).tasks()
    assert [(task.case, task.method) for task in tasks] == [
        ("level 1, nu 0.45", PRISMS),
        ("level 1, nu 0.499", PRISMS),
        ("level 2, nu 0.45", PRISMS),
        ("level 1, nu 0.45", FREE),
        ("level 1, mean head", MIRRORED),
        ("level 2, mean head", MIRRORED),
    ]


def test_one_law_at_every_ratio_and_linear_tets_as_the_reference_fail():
    assert passed(rows()) == [True, True]
    assert passed(rows(highest=1.0)) == [False, True]
    assert passed(rows(highest=0.99 * LOCKS)) == [False, True]
    # Linear tets in the place of the quadratic ones of the free mesh.
    assert passed(rows(free_quadratic=0.01)) == [True, False]
    assert passed(rows(free_quadratic=1.01 * TWO_MESHES * 0.018)) == [True, False]


def test_tables_and_words_are_of_the_rows():
    study = Locking()
    (table,) = study.tables(rows())
    assert table.rows[2][:3] == ("level 1, nu 0.499", "P2", "0.0180 / 1.000 / 6.90")
    assert "level 1, nu 0.499: linear tets are 0.018 mm from quadratic ones" in study.words(rows())
    assert "<svg" in "".join(study.pictures(rows()).values())
