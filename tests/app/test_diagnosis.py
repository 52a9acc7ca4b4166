"""Diagnoses: evidence that is what the filters did, words that are what the evidence says, and what they promise."""

from __future__ import annotations

import dataclasses
import json
import math
from functools import partial
from typing import Any

import numpy as np
import pytest

from app import cli, session
from app.diagnosis import particles
from app.diagnosis.advice import findings as advice
from app.diagnosis.ancestry import (
    ENOUGH,
    LUCK,
    great_losses,
    left_of,
    losses,
    parents,
    particles_for,
    since_resampling,
    tau_to_common_ancestors,
)
from app.diagnosis.causes import causes, kind_of, of_the_shape
from app.diagnosis.collecting import Collector
from app.diagnosis.consistency import findings as consistency
from app.diagnosis.consistency import mean_ratio
from app.diagnosis.diagnose import diagnose
from app.diagnosis.evidence import Numbers, Observations, record_of
from app.diagnosis.findings import Case, Diagnosis, Finding, amount, percent
from app.diagnosis.reading import read_cases
from app.diagnosis.words import as_dict, commands
from app.recording import Recorder
from app.recording.reading import Recording
from app.recording.stream import FileStream
from app.recording.writer import Writer
from app.types import SessionInfo, SessionStep
from scenarios.registry import build
from slam.estimators import ESTIMATORS
from slam.types import Params


def collected(world: str, key: str, seed: int = 0, steps: int | None = None, **params: Any) -> Case:
    source, collector = build(world), Collector()
    chosen = source.params(**({"particles": 100} | params))
    session.run(session.make_info(source, [ESTIMATORS[key]], chosen, None, seed, steps), [collector])
    return collector.cases()[0]


def made(seen: list[Observations] | None = None, **columns: Any) -> Case:
    """A case with these numbers, (T,) or one for all; usual ones where none are given."""
    T = max((len(c) for c in columns.values() if np.ndim(c)), default=20)
    usual = dict.fromkeys(Numbers._fields, 0.0) | {"particles": 100.0, "diversity": 1.0, "n_eff": 100.0, "inside": 1.0}
    usual |= {"matched": 2.0, "observed": 2.0, "nis_first": 1.0, "nis_second": 1.0, "nees_position": 1.4}
    usual |= {"survivors": np.round(np.multiply(columns.get("diversity", 1.0), columns.get("particles", 100.0)))}
    rows = np.array([np.broadcast_to(np.asarray(value, float), T) for value in (usual | columns).values()]).T
    nothing = Observations(np.zeros(0), np.zeros(0, np.int64), np.zeros(0))
    record = record_of(np.arange(1, T + 1), Numbers._fields, rows, seen or [nothing] * T)
    return Case("dfs", "Dual FastSLAM", False, dataclasses.asdict(Params()), record)


def _info() -> SessionInfo:
    source = build("paper-line")
    return session.make_info(source, [ESTIMATORS["dfs"]], source.params(), None, 0)


@pytest.fixture(scope="module")
def joint() -> Case:
    return collected("paper-line", "dfs", weighting="joint")


@pytest.fixture(scope="module")
def run() -> tuple[list[SessionStep], Case]:
    source, collector = build("paper-line"), Collector()
    info = session.make_info(source, [ESTIMATORS["fs2"]], source.params(particles=20), None, 3)
    steps = list(session.steps(info))
    collector.begin(info)
    for step in steps:
        collector.step(step)
    return steps, collector.cases()[0]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, list[Case]]:
    path = tmp_path_factory.mktemp("diagnosis") / "a.rrd"
    source, collector = build("paper-line"), Collector()
    chosen = source.params(particles=30)
    info = session.make_info(source, [ESTIMATORS[k] for k in ("dfs", "ekf")], chosen, None, 2)
    session.run(info, [Recorder(path), collector])
    return path, collector.cases()


class TestEvidence:
    """Against what is computed anew from the traces."""

    def test_pairs_with_one_parent_are_counted(self, run: tuple[list[SessionStep], Case]) -> None:
        steps, case = run
        assert any(step.filters["fs2"].trace.did_resample for step in steps)
        for step, related, survivors in zip(steps, case.record["related"], case.record["survivors"], strict=True):
            parents = step.filters["fs2"].trace.ancestors.tolist()
            pairs = [(i, j) for i in range(20) for j in range(20) if i != j]
            assert related == pytest.approx(sum(parents[i] == parents[j] for i, j in pairs) / len(pairs))
            assert survivors == len(set(parents))

    def test_weights_before_and_after(self, run: tuple[list[SessionStep], Case]) -> None:
        steps, case = run
        for step, before, after in zip(steps, case.record["n_eff_before"], case.record["n_eff"], strict=True):
            trace = step.filters["fs2"].trace
            assert before == pytest.approx(1.0 / (np.exp(trace.predicted.log_w) ** 2).sum())
            assert after == trace.n_eff

    def test_widths_are_sensor_sharp_once_the_pose_is_fixed(self, joint: Case) -> None:
        """At step 2 of the paper's line: 3 landmarks in sight, one after the other."""
        seen = joint.record.observations[1]
        assert seen.widths[0] > 10.0
        assert 1.0 <= seen.widths[2] < 1.5
        assert of_the_shape(seen, 1.0).tolist() == [False, False, True]

    @pytest.mark.parametrize(
        ("key", "weighting", "expected"),
        [("dfs", "joint", 1.0), ("dfs", "marginal", 0.0), ("fs2", "marginal", 1.0), ("fs1", "marginal", 0.0)],
    )
    def test_whether_observations_are_weighed_in_turn(self, key: str, weighting: str, expected: float) -> None:
        record = collected("paper-line", key, steps=4, particles=5, weighting=weighting).record
        assert (record["in_turn"][1:] == expected).all()

    def test_a_filter_that_is_switched_on_late_has_its_own_steps(self, run: tuple[list[SessionStep], Case]) -> None:
        steps, _ = run
        collector = Collector()
        collector.begin(_info())
        for step in steps[10:15]:
            collector.step(step)
            collector.step(step)  # once more, as after going back
        assert collector.cases()[0].record.steps.tolist() == [11, 12, 13, 14, 15]
        earlier = collector.part(13)
        assert earlier.cases()[0].record.steps.tolist() == [11, 12, 13]
        earlier.step(steps[13])
        assert earlier.cases()[0].record.steps.tolist() == [11, 12, 13, 14]
        assert collector.cases()[0].record.steps.tolist() == [11, 12, 13, 14, 15]


class TestShape:
    """Which observations tell of the map's shape only."""

    @staticmethod
    def seen(*widths: float) -> Observations:
        return Observations(np.zeros(len(widths)), np.zeros(len(widths), np.int64), np.array(widths))

    @pytest.mark.parametrize(
        ("widths", "expected"),
        [
            ((18.0, 4.0, 1.2), [False, False, True]),
            ((18.0, 4.0), [False, False]),
            ((18.0, 23.0, 24.0), [False, False, False]),  # all at the predicted pose
            ((1.1, 1.1, 1.0, 1.1), [False] * 4),  # no uncertain pose at all: FastSLAM 1.0
            ((math.nan, 18.0, 4.0, math.nan, 1.2), [False, False, False, False, True]),
            ((), []),
        ],
    )
    def test_third_and_later_ones_that_are_sharp(self, widths: tuple[float, ...], expected: list[bool]) -> None:
        assert of_the_shape(self.seen(*widths), 1.0).tolist() == expected
        assert of_the_shape(self.seen(*widths), math.nan).tolist() == expected  # an earlier version did not tell

    def test_none_where_all_are_weighed_at_the_predicted_pose(self) -> None:
        """Then one is sharp because it is near, and another one is not because it is far."""
        assert not of_the_shape(self.seen(18.0, 4.0, 1.2), 0.0).any()


class TestCauses:
    def test_shares_are_weighed_by_the_variance_of_their_steps(self) -> None:
        seen = [
            Observations(np.array([0.25, 0.75]), np.array([4, 7]), np.array([9.0, 9.0])),
            Observations(np.array([1.0]), np.array([7]), np.array([9.0])),
        ]
        case = made(seen, deviation=np.array([1.0, 2.0]), first=np.array([0.0, 1.0]), second=np.array([1.0, 0.0]))
        found = causes(case.record, slice(None))
        assert found.variance == 5.0
        assert (found.first, found.second) == pytest.approx((0.8, 0.2))
        assert (found.decisive, found.features) == (1, {7: 1.0})

    def test_features_are_those_of_the_step_that_weighed_most(self) -> None:
        """The best map is another one at other steps, with other indices."""
        seen = [
            Observations(np.array([0.25, 0.75]), np.array([4, 7]), np.array([9.0, 9.0])),
            Observations(np.array([1.0]), np.array([2]), np.array([9.0])),
        ]
        found = causes(made(seen, deviation=np.array([2.0, 1.9])).record, slice(None))
        assert list(found.features) == [7, 4]
        assert found.decisive == 0

    @pytest.mark.parametrize(
        ("columns", "kind"),
        [
            ({"unmatched": 0.6, "first": 0.4}, "what was not matched"),
            ({"drawn": 0.7, "first": 0.3}, "draw of the pose"),
            ({"wide_second": 5.0, "second": 1.0}, "proposal wider than the sensor"),
            ({"first": 1.0}, "observations"),
        ],
    )
    def test_kinds(self, columns: dict[str, Any], kind: str) -> None:
        assert kind_of(causes(made(deviation=1.0, **columns).record, slice(None))) == kind

    def test_a_loss_is_traced_back_to_the_resampling_before(self) -> None:
        record = made(resampled=np.array([0, 0, 1, 0, 0, 1, 0])).record
        assert [since_resampling(record, i) for i in (2, 5, 6)] == [slice(0, 3), slice(3, 6), slice(6, 7)]

    def test_nor_further_than_to_a_change_of_k(self) -> None:
        record = made(particles=np.array([9.0, 9.0, 5.0, 5.0, 5.0])).record
        assert [since_resampling(record, i) for i in (1, 2, 4)] == [slice(0, 2), slice(2, 3), slice(2, 5)]

    @pytest.mark.parametrize("steps", [1, 2, 3])
    @pytest.mark.parametrize("key", list(ESTIMATORS))
    def test_of_a_short_run(self, key: str, steps: int) -> None:
        found = diagnose(collected("paper-line", key, steps=steps, particles=9))
        assert ("founders" in found.kinds()) == (key != "ekf")
        assert not any("nan" in finding.text for finding in found.findings)

    @pytest.mark.parametrize("key", ["dfs", "fs2"])
    def test_of_a_run_that_never_resampled(self, key: str) -> None:
        found = diagnose(collected("paper-line", key, particles=20, resample_below=0.0))
        assert any("No step lost many founders" in finding.text for finding in found.findings)
        assert _founders(found) == 20.0
        assert "resample earlier" in found.kinds()
        assert not {"enough particles", "not for want of particles"} & found.kinds()
        assert any("resample_below=0.5" in line for f in found.findings for line in f.tries)

    def test_the_feature_that_decides_is_named(self) -> None:
        seen = [Observations(np.array([0.9, 0.1]), np.array([7, 3]), np.array([9.0, 9.0]))] * 3
        diversity = np.array([1.0, 0.3, 0.3])
        case = made(seen, deviation=1.0, first=1.0, diversity=diversity, resampled=np.array([0, 1, 0]), n_eff=30.0)
        texts = [f.text for f in diagnose(case).findings if f.kind.startswith("loss")]
        assert len(texts) == 1
        assert texts[0].startswith("Step 2: founders 100 to 30, N_eff 30 of 100; ")
        assert "feature 7 90 %" in texts[0]
        assert "100 % is by ranges" in texts[0]


class TestAncestry:
    def test_the_coalescent_tells_how_many_founders_are_left(self) -> None:
        """By simulation: 40 resamplings of 200 equal particles, multinomial."""
        rng, left, expected = np.random.default_rng(1), [], []
        for _ in range(30):
            lineage, related, K = np.arange(200), [], 200
            for _ in range(40):
                parents = rng.integers(0, K, K)
                lineage = lineage[parents]
                children = np.bincount(parents)
                related.append(float(children @ (children - 1.0)) / (K * (K - 1.0)))
            left.append(len(set(lineage.tolist())))
            case = made(related=np.array(related), particles=200.0, diversity=left[-1] / 200.0)
            expected.append(losses(case.record).expected())
        assert np.mean(left) == pytest.approx(np.mean(expected), rel=0.1)

    @pytest.mark.parametrize("founders", [2.0, 10.0, 30.0])
    @pytest.mark.parametrize("per_particle", [0.0, 1e-9, 0.3, 4.0, 1e4])
    def test_particles_asked_for_keep_exactly_so_many(self, founders: float, per_particle: float) -> None:
        K = particles_for(founders, per_particle)
        assert founders - 1e-6 <= K
        assert left_of(K, per_particle / K) == pytest.approx(founders)

    def test_parents_of_a_step(self) -> None:
        """9 children of 5, 3, 1 and 0 of 4 parents."""
        children = np.array([5, 3, 1, 0])
        related = (children * (children - 1)).sum() / (9 * 8)
        assert parents(np.array([9.0]), np.array([related]))[0] == pytest.approx(81 / (children**2).sum())

    def test_when_half_were_gone(self) -> None:
        case = made(diversity=np.array([1.0, 0.8, 0.5, 0.2, 0.1, 0.1]))
        founders = diagnose(case).findings[0]
        assert founders.text.startswith("10 of 100 founders are left after step 6; half were gone by step 3, 90 % were")
        assert not any(finding.kind == "K changed" for finding in diagnose(case).findings)
        assert founders.steps == (3, 5)
        assert founders.warns

    def test_a_change_of_k_is_no_loss(self) -> None:
        """100 founders, 60 left, then 10 particles, of which 8 and 4 are left."""
        K = np.array([100.0, 100.0, 10.0, 10.0])
        case = made(particles=K, diversity=np.array([60.0, 60.0, 8.0, 4.0]) / K, related=np.array([0.1, 0.1, 0.5, 0.2]))
        found = diagnose(case)
        texts = {finding.kind: finding.text for finding in found.findings}
        assert texts["K changed"].startswith("K was changed from 100 to 10 at step 3, when 60 founders were left: ")
        assert texts["founders"].startswith("4 of 8 founders are left after step 4; half were gone by step 4; ")
        assert great_losses(case.record).tolist() == [0, 3]
        assert losses(case.record).tau == 0.2  # what is before, and the change itself, count nothing

    def test_of_the_middle_of_a_run_founders_are_those_that_are_left(self) -> None:
        """Of 100 particles 40 founders are left, and no step takes any."""
        middle = made(diversity=0.4, survivors=100.0)
        assert losses(middle.record).first == 40.0
        assert not len(great_losses(middle.record))
        begins = made(diversity=0.4, survivors=40.0)
        assert losses(begins.record).first == 100.0
        assert great_losses(begins.record).tolist() == [0]

    def test_one_particle_has_no_diversity(self) -> None:
        kinds = diagnose(collected("paper-line", "ekf", particles=1)).kinds()
        assert "founders" not in kinds
        assert not {kind for kind in kinds if "particles" in kind}


class TestConsistency:
    def test_innovations_of_a_right_filter_pass_and_of_a_wrong_one_do_not(self) -> None:
        rng = np.random.default_rng(0)
        for factor, expected in ((1.0, "ranges as expected"), (3.0, "ranges off"), (0.3, "ranges cautious")):
            nis = factor * rng.chisquare(1, 200)
            kinds = {f.kind for f in consistency(made(nis_first=nis, nis_second=rng.chisquare(1, 200)))}
            assert expected in kinds
            assert "bearings as expected" in kinds

    def test_false_alarms_are_rare(self) -> None:
        rng = np.random.default_rng(1)
        ratios = [mean_ratio(rng.chisquare(1, 60), np.ones(60)) for _ in range(300)]
        assert sum(abs(deviations) > 4.0 and ratio > 1.5 for ratio, deviations, _ in ratios) <= 1

    def test_what_a_few_steps_make_is_no_consistent_filter(self) -> None:
        """A mean that is far from 1 is never called as it should be."""
        nis = np.concatenate([np.random.default_rng(0).chisquare(1, 59), [1e5]])
        found = next(f for f in consistency(made(nis_first=nis)) if f.kind.startswith("ranges"))
        assert (found.kind, found.steps, found.warns) == ("ranges off at times", (60,), True)

    @pytest.mark.parametrize(
        ("nees", "kind", "said"),
        [
            (np.full(40, 1.4), "consistent", "no sign of overconfidence"),
            (np.concatenate([np.full(35, 1.4), np.full(5, 9.0)]), "consistent", "it may be chance"),
            (np.full(40, 0.3), "cautious", "errors are smaller than it believes"),
        ],
    )
    def test_nees_that_is_not_overconfident(self, nees: Any, kind: str, said: str) -> None:
        found = consistency(made(nees_position=nees))[0]
        assert found.kind == kind
        assert said in found.text

    def test_a_measured_truth_is_said_to_be_one(self) -> None:
        case = made(nees_position=np.full(40, 1.4))
        assert "a truth that was measured" in consistency(case._replace(measured=True))[0].text
        assert "a truth that was measured" not in consistency(case)[0].text

    def test_an_error_that_innovations_do_not_show(self) -> None:
        nis = np.random.default_rng(0).chisquare(1, (2, 60))
        wrong = made(nees_position=np.full(60, 9.0), nis_first=nis[0], nis_second=nis[1])
        assert "error unseen" in {f.kind for f in consistency(wrong)}
        assert "error unseen" not in {f.kind for f in consistency(made(nis_first=nis[0], nis_second=nis[1]))}

    def test_the_longest_time_above_the_band_is_named(self) -> None:
        nees = np.concatenate([np.full(12, 9.0), np.full(3, 1.0), np.full(20, 9.0), np.full(2, 1.0), np.full(3, 9.0)])
        found = consistency(made(nees_position=nees))[0]
        assert "longest from step 16 to 35" in found.text
        assert found.steps == (16,)

    def test_overconfidence(self) -> None:
        nees = np.concatenate([np.full(10, 1.0), np.full(20, 9.0)])
        found = consistency(made(nees_position=nees, nis_first=1.0, nis_second=1.0))
        assert found[0].kind == "overconfident"
        assert found[0].steps == (11,)
        assert "67 %" in found[0].text
        assert "longest from step 11 to 30" in found[0].text
        assert (
            consistency(made(nees_position=np.full(30, math.nan), nis_first=np.full(30, 1.0)))[0].kind
            != "overconfident"
        )

    def test_a_cautious_filter_is_told_why_if_that_was_asked_for(self) -> None:
        case = made(nis_first=np.full(80, 0.2))
        inflated = case._replace(params={**case.params, "inflate_r": 9.0})
        texts = [next(f.text for f in consistency(c) if f.kind == "ranges cautious") for c in (case, inflated)]
        assert "worse than it is" in texts[0]
        assert "by inflate_r 9" in texts[1]


class TestLuck:
    """How uncertain the estimate is by the luck of the particles alone."""

    @staticmethod
    def told(case: Case) -> list[Finding]:
        return [found for found in consistency(case) if found.kind == "luck"]

    def test_a_fifth_of_the_deviation_is_said_and_half_of_it_is_a_warning(self) -> None:
        (little,) = self.told(made(monte_carlo_m=np.full(30, 0.02), spread_m=0.1))
        assert "uncertain by 0.02 m at step 30 " in little.text
        assert "beside the 0.1 m that it reports: that adds 4 % to the variance of its errors." in little.text
        assert (little.warns, little.steps) == (False, (30,))
        (much,) = self.told(made(monte_carlo_m=np.full(30, 0.05), spread_m=0.1))
        assert much.text.endswith("that adds 25 % to the variance of its errors, and less with more particles.")
        assert much.warns

    def test_it_is_told_of_the_last_step_at_which_founders_tell(self) -> None:
        luck = np.concatenate([np.linspace(0.01, 0.04, 15), np.full(25, math.nan)])
        (found,) = self.told(made(monte_carlo_m=luck, spread_m=np.full(40, 0.1)))
        assert (found.steps, found.numbers["luck_m"]) == ((15,), 0.04)
        assert "After that too few founders are left to tell" in found.text
        (found,) = self.told(made(monte_carlo_m=luck[:20], spread_m=0.1))  # they may tell again
        assert "After that" not in found.text

    def test_nothing_is_said_where_nothing_can_be_told(self) -> None:
        assert not self.told(made(monte_carlo_m=np.full(30, math.nan), spread_m=0.1))
        assert not self.told(made(monte_carlo_m=np.full(30, 0.0), spread_m=0.1))  # nothing was drawn yet
        assert not self.told(made(monte_carlo_m=np.full(9, 0.02), spread_m=0.1))
        assert not self.told(collected("paper-line", "ekf", steps=20))

    def test_a_filter_of_ours(self) -> None:
        """With four times as many particles luck does half as much, within a third."""
        few, many = (self.told(collected("loop", "dfs", 1, 60, particles=k))[0].numbers["luck_m"] for k in (50, 200))
        assert few / many == pytest.approx(2.0, rel=0.33)


class TestAdvice:
    def test_particles_by_the_numbers(self) -> None:
        related = np.full(20, 0.02)  # tau 0.4: 5.3 of 100 founders are expected, and 5 are left
        found = advice(made(related=related, diversity=0.05), [])[0]
        assert found.kind == "more particles"
        assert found.numbers["particles"] == math.ceil(particles_for(LUCK * ENOUGH, 40.0) / 10.0) * 10
        assert found.text == "With 620 particles 10 founders should be left with most seeds."
        assert found.tries == (f"--from 1 --set particles={found.numbers['particles']:.0f}",)

    def test_in_vain(self) -> None:
        found = advice(made(related=np.full(20, 0.9), diversity=0.01), [])[0]
        assert (found.kind, found.tries) == ("more particles in vain", ())
        assert "1.1 parents of 100" in found.text

    @pytest.mark.parametrize("K", [2.0, 3.0, 5.0, 9.0])
    def test_few_particles_are_not_in_vain(self, K: float) -> None:
        """However they went: ten times as many might do well."""
        found = advice(made(related=np.full(60, 1.0), diversity=1.0 / K, particles=K), [])[0]
        assert found.kind == "more particles at least"
        assert found.numbers["particles"] >= 10.0 * K

    @pytest.mark.parametrize(
        ("columns", "kinds", "why"),
        [
            ({"related": 0.02, "diversity": 0.05}, {"ranges off"}, "innovations are not what the filter expects"),
            ({"related": 0.02, "diversity": 0.05}, {"shape of the map"}, "the shape of a map is inherited"),
            ({"related": 0.08, "diversity": 0.01}, set(), "with 1 left, and few expected, they do not show"),
            ({"related": 0.02, "diversity": 0.02}, set(), "2 are left where 5.3 are expected"),
        ],
    )
    def test_numbers_that_do_not_tell(self, columns: dict[str, float], kinds: set[str], why: str) -> None:
        found = particles.findings(made(None, **{name: np.full(20, value) for name, value in columns.items()}), kinds)[
            0
        ]
        assert found.kind == "more particles at least"
        assert why in found.text

    def test_lines_that_meet_too_soon(self) -> None:
        """Steps of r = .1: common ancestors 20 steps back on the average are a coalescent's, 5 steps back are not."""
        for age, sooner in ((20.0, False), (5.0, True)):
            case = made(related=np.full(150, 0.1), common_ancestor=age, diversity=0.01)
            assert tau_to_common_ancestors(case.record) == pytest.approx(age * 0.1)
            assert ("times sooner" in particles.findings(case, set())[0].text) == sooner

    def test_a_mistake_comes_first(self) -> None:
        found = Finding("mistake", "shared-maps", "")
        assert [f.kind for f in advice(made(diversity=0.01), [found])] == ["repair"]

    def test_noise_is_not_told_of_particles_that_died_out(self) -> None:
        off, depleted = (
            Finding("consistency", "ranges off", "", numbers={"ratio": 9.0}),
            Finding("diversity", "depleted", ""),
        )
        assert "larger noise" in {f.kind for f in advice(made(diversity=0.5), [off])}
        assert "larger noise" not in {f.kind for f in advice(made(diversity=0.5), [off, depleted])}

    def test_noise_is_told_with_what_is_tried(self) -> None:
        off, case = Finding("consistency", "ranges off", "", numbers={"ratio": 1.69}), made(diversity=0.5)
        case = case._replace(params={**case.params, "inflate_r": 4.0})
        found = next(f for f in advice(case, [off]) if f.kind == "larger noise")
        assert "deviations 1.3 times larger" in found.text
        assert "1.7 times the covariance (inflate_r 4 to 6.76)" in found.text
        assert found.tries == ("--from 1 --set inflate_r=6.76",)

    def test_of_a_small_sample_more_are_tried(self) -> None:
        """Though no step left few parents, and the coalescent agrees with what is left."""
        related, left = np.full(20, 0.02), 4.0
        few = made(related=related, diversity=left / 15.0, particles=15.0)
        found = particles.findings(few, set())[0]
        assert (found.kind, found.numbers["particles"]) == ("more particles at least", 150.0)
        assert "15 particles are too few to tell by" in found.text
        enough = made(related=related, diversity=left / 25.0, particles=25.0)
        assert particles.findings(enough, set())[0].kind == "more particles"

    def test_one_particle(self) -> None:
        case = made(related=math.nan, particles=1.0)
        assert advice(case, [])[0].kind == "more particles at least"
        assert not advice(case._replace(key="ekf"), [])

    def test_a_lower_bound_beyond_what_is_practical_is_in_vain(self) -> None:
        """One of 1000 left where many are expected: thirty times as many would be needed in proportion."""
        found = advice(made(related=np.full(20, 0.001), diversity=0.001, particles=1000.0), [])[0]
        assert found.kind == "more particles in vain"
        assert "weights depend on what particles have inherited" in found.text

    def test_over_a_long_run_lines_meet(self) -> None:
        found = advice(made(related=np.full(3000, 0.02), diversity=0.01), [])[0]
        assert found.kind == "particles for a window"
        assert found.numbers["particles_for_window"] == math.ceil(particles_for(LUCK * ENOUGH, 200.0) / 10.0) * 10

    @pytest.mark.parametrize(
        ("association", "gate", "tries"),
        [
            ("jcbb", 0.99, ["association=nearest", "gate=0.999"]),
            ("nearest", 0.99999999, ["association=jcbb", "gate=0.999999999"]),
            ("nearest", 1.0 - 1e-10, ["association=jcbb"]),
            ("known", 0.99, ["gate_known=0.99999"]),
        ],
    )
    def test_other_association(self, association: str, gate: float, tries: list[str]) -> None:
        """Nothing that a run would refuse, and of known tags nothing but how far they are believed."""
        case = made(observed=4.0, matched=2.0, deviation=1.0, first=1.0)
        case = case._replace(params={**case.params, "association": association, "gate": gate, "gate_known": 0.9999})
        found = next(f for f in diagnose(case).findings if f.kind == "other association")
        assert [line.rpartition(" ")[2] for line in found.tries] == tries

    def test_weights_that_are_inherited(self) -> None:
        found = advice(made(related=np.full(20, 0.005), diversity=0.02), [])[0]  # 18 are expected
        assert found.kind == "more particles at least"
        assert found.numbers["particles"] >= 100.0 * 3.0 * ENOUGH / 2.0

    def test_enough(self) -> None:
        assert advice(made(related=np.full(20, 0.001), diversity=0.5), [])[0].kind == "enough particles"

    def test_commands(self, joint: Case) -> None:
        lines = [line for f in diagnose(joint).findings for line in commands(f, "a.rrd")]
        assert "dualslam whatif a.rrd --from 1 --set weighting=marginal" in lines
        quoted = [line for f in diagnose(joint).findings for line in commands(f, "my runs/a.rrd")]
        assert "dualslam whatif 'my runs/a.rrd' --from 1 --set weighting=marginal" in quoted


class TestCases:
    """What the diagnoses of real runs say; `dualslam study diagnosis` has the rates of more of them."""

    def test_the_shape_of_the_map_depletes_joint_weights_and_not_marginal_ones(self) -> None:
        named = {"joint": 0, "marginal": 0}
        for weighting in named:
            for seed in range(300, 306):
                found = diagnose(collected("paper-line", "dfs", seed, weighting=weighting))
                named[weighting] += "shape of the map" in found.kinds()
                if weighting == "joint":
                    loss = next(f for f in found.findings if f.kind == "loss: shape of the map")
                    seen = found.case.record["observed"][loss.steps[0] - 1]
                    assert seen >= 3.0
        assert named["joint"] >= 5
        assert named["marginal"] == 0

    def test_fastslam1_starves_on_a_sharp_sensor_and_more_particles_are_in_vain(self) -> None:
        found = diagnose(collected("paper-line", "fs1", 300))
        assert {
            "proposal wider than the sensor",
            "more particles in vain",
            "depleted",
            "better proposal",
        } <= found.kinds()
        more = diagnose(collected("paper-line", "fs1", 1300, particles=1000))
        assert _founders(more) < ENOUGH

    def test_as_many_particles_as_it_asks_for_keep_the_founders(self) -> None:
        kept = 0
        for seed in range(300, 306):
            found = diagnose(collected("paper-line", "fs2", seed, particles=30))
            asked = next(f for f in found.findings if f.kind.startswith("more particles"))
            assert _founders(found) < ENOUGH
            then = collected("paper-line", "fs2", seed + 1000, particles=int(asked.numbers["particles"]))
            kept += _founders(diagnose(then)) >= ENOUGH
        assert kept >= 5


def _founders(found: Diagnosis) -> float:
    return next(f for f in found.findings if f.kind == "founders").numbers["founders_left"]


class TestRecordings:
    def test_a_recording_says_the_same_as_its_session(self, recorded: tuple[Any, list[Case]]) -> None:
        path, cases = recorded
        read = read_cases(path)
        assert [case.key for case in read.cases] == ["dfs", "ekf"]
        for case, own in zip(read.cases, cases, strict=True):
            for name in Numbers._fields:
                np.testing.assert_array_equal(case.record[name], own.record[name])
            for a, b in zip(case.record.observations, own.record.observations, strict=True):
                assert all(np.array_equal(x, y, equal_nan=True) for x, y in zip(a, b, strict=True))
            assert as_dict(diagnose(case)) == as_dict(diagnose(own))

    def test_text_and_json(self, recorded: tuple[Any, list[Case]], tmp_path: Any, capsys: Any) -> None:
        path, cases = recorded
        out = tmp_path / "out.json"
        assert cli.entry(["diagnose", str(path), "--json", str(out)]) == 0
        text, told = capsys.readouterr().out, json.loads(out.read_text())
        assert text.startswith("paper-line, seed 2, step 59 of 59\n")
        assert list(told["filters"]) == ["dfs", "ekf"]
        for finding in told["filters"]["dfs"]["findings"]:
            assert finding["text"] in text
        assert told["filters"]["dfs"] == as_dict(diagnose(cases[0]))

    def test_one_without_evidence_says_what_is_missing(
        self, recorded: tuple[Any, list[Case]], monkeypatch: Any
    ) -> None:
        path, cases = recorded
        plain = Recording._rows

        def without(self: Recording, entity: str, *rest: Any) -> Any:
            return [] if entity.startswith("/evidence") else plain(self, entity, *rest)

        monkeypatch.setattr(Recording, "_rows", without)
        monkeypatch.setattr(Recording, "entities", [])
        found = diagnose(read_cases(path).cases[0])
        assert {"founders", "evidence"} <= found.kinds()
        assert not {"observations", "shape of the map", "more particles", "enough particles"} & found.kinds()
        assert _founders(found) == _founders(diagnose(cases[0]))

    def test_a_cut_one_is_read_up_to_there(self, tmp_path: Any, capsys: Any) -> None:
        source, path = build("paper-line"), tmp_path / "cut.rrd"
        info = session.make_info(source, [ESTIMATORS["dfs"]], source.params(particles=30), None, 2)
        recorder = Recorder(path)
        recorder.begin(info)
        for step in list(session.steps(info))[:30]:
            recorder.step(step)
        recorder.end()
        path.write_bytes(path.read_bytes()[:-5000])
        assert cli.entry(["diagnose", str(path)]) == 0
        captured = capsys.readouterr()
        assert "is damaged: it is read as far as that goes, to step" in captured.err
        assert "Dual FastSLAM" in captured.out

    @pytest.mark.parametrize(
        ("words", "said"),
        [
            (["diagnose"], "diagnose needs a recording"),
            (["diagnose", "nothing.rrd"], "nothing.rrd cannot be read"),
            (["diagnose", "README.md"], "README.md is no Rerun recording"),
            (["diagnose", "nothing.rrd", "--json", "nowhere/x.json"], "nowhere does not exist"),
        ],
    )
    def test_bad_input(self, words: list[str], said: str, capsys: Any) -> None:
        assert cli.entry(words) == 2
        assert said in capsys.readouterr().err

    def test_a_branch_has_what_was_before_it_left(self, tmp_path: Any) -> None:
        """A branch of a branch: its founders are those of the run, and its parameters those that were set last."""
        path, source = tmp_path / "branches.rrd", build("paper-line")
        info = session.make_info(source, [ESTIMATORS["fs2"]], source.params(particles=30), None, 2)
        trunk, state, collector = Writer(info, partial(FileStream, path)), session.start(info), Collector()
        collector.begin(info)
        writer, params, last = trunk, info.params, 30
        for index in range(1, last + 1):
            said: tuple[str, ...] = ()
            if index in (11, 21):  # the branches; the second one with fewer particles from its fifth step on
                writer = writer.fork(info._replace(params=params), f"from {index}")
            if index == 25:
                said = session.describe_change(params, dataclasses.replace(params, particles=20))
                params = dataclasses.replace(params, particles=20)
            state, step = session.advance(info, state, params)
            step = dataclasses.replace(step, changes=said)
            writer.step(step)
            collector.step(step)
            if index == 10:
                for _ in range(3):  # the run itself goes on
                    trunk.step(dataclasses.replace(step, index=step.index + 1))
        writer.close()
        trunk.close()
        (own,), (read,) = collector.cases(), read_cases(path, "from-21").cases
        assert read.record.steps.tolist() == list(range(1, last + 1))
        for name in Numbers._fields:
            np.testing.assert_array_equal(read.record[name], own.record[name])
        assert read.params == own.params
        assert as_dict(diagnose(read)) == as_dict(diagnose(own))
        assert losses(read_cases(path).cases[0].record).first == 30.0

    def test_a_branch_that_is_not_there(self, recorded: tuple[Any, list[Case]], capsys: Any) -> None:
        assert cli.entry(["diagnose", f"{recorded[0]}#six"]) == 2
        assert "has no branch 'six'" in capsys.readouterr().err


class TestWhileItRuns:
    """A session whose filters, parameters and branches come and go."""

    @staticmethod
    def steps(key: str, count: int, particles: tuple[int, ...] = (20,), seed: int = 0) -> list[SessionStep]:
        """With another number of particles every `count` steps."""
        source = build("paper-line")
        info = session.make_info(source, [ESTIMATORS[key]], source.params(particles=particles[0]), None, seed)
        changes = [
            session.Change(1 + i * count, dataclasses.replace(info.params, particles=K))
            for i, K in enumerate(particles)
        ]
        return list(session.steps(info._replace(steps=count * len(particles)), changes))

    def test_a_filter_is_not_there_before_it_was_switched_on(self) -> None:
        collector = Collector()
        collector.begin(_info())
        late = self.steps("fs2", 15)[9:]
        for step in [*self.steps("dfs", 9), *late]:
            collector.step(step)
        assert [case.key for case in collector.part(9).cases()] == ["dfs"]
        assert [case.key for case in collector.part(10).cases()] == ["dfs", "fs2"]

    def test_parameters_are_those_of_the_step(self) -> None:
        collector = Collector()
        collector.begin(_info())
        for step in self.steps("dfs", 5, (20, 30)):
            collector.step(step)
        assert [collector.part(until).cases()[0].params["particles"] for until in (5, 6)] == [20, 30]

    @pytest.mark.parametrize("particles", [(100, 1, 100), (1, 50), (20, 1), (5, 3, 2)])
    @pytest.mark.parametrize("key", ["dfs", "fs2", "fs1"])
    def test_any_number_of_particles(self, key: str, particles: tuple[int, ...]) -> None:
        collector = Collector()
        collector.begin(_info())
        for step in self.steps(key, 6, particles):
            collector.step(step)
        record = collector.cases()[0].record
        assert record["particles"].tolist() == [float(K) for K in particles for _ in range(6)]
        for until in range(1, 6 * len(particles) + 1):
            found = diagnose(collector.part(until).cases()[0])
            assert not any("nan" in finding.text for finding in found.findings)
            assert ("K changed" in found.kinds()) == (until > 6)


@pytest.mark.parametrize(
    ("share", "text"), [(0.0, "0 %"), (0.5, "50 %"), (0.0021, "0.21 %"), (1e-6, "less than 0.01 %")]
)
def test_shares_in_words(share: float, text: str) -> None:
    assert percent(share) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(2240.0, "2200"), (160.3, "160"), (0.0621, "0.062"), (math.inf, "infinite"), (3.71e8, "3.7e+08"), (2.0, "2")],
)
def test_amounts_in_words(value: float, text: str) -> None:
    assert amount(value) == text
