from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from slam_bof.errors import ConfigError, PluginError
from slam_bof.geometry import AlignmentParams
from slam_bof.slam import Config, PluginChoice, config


@pytest.mark.parametrize("name", config.presets())
def test_presets_load_and_survive_a_round_trip(name: str, tmp_path: Path) -> None:
    loaded = config.preset(name)
    config.complete(loaded)
    file = tmp_path / "config.yaml"
    file.write_text(config.dump(loaded))
    assert config.load(file) == loaded
    assert set(yaml.safe_load(config.dump(loaded))) == set(Config.model_fields)


def test_the_presets_are_the_two_that_are_documented() -> None:
    assert config.presets() == ["indoor", "paper"]
    assert config.preset("paper").keyframes.policy == "every"
    assert config.preset("indoor").keyframes.policy == "motion"


def test_an_empty_file_is_all_defaults(tmp_path: Path) -> None:
    file = tmp_path / "empty.yaml"
    file.write_text("# nothing\n")
    assert config.load(file) == Config()


def test_a_plugin_may_be_a_bare_name(tmp_path: Path) -> None:
    file = tmp_path / "c.yaml"
    file.write_text("odometry: mine\nbackend: {name: gtsam, options: {cauchy: 2.0}}\n")
    loaded = config.load(file)
    assert loaded.odometry == PluginChoice(name="mine")
    assert loaded.backend.options == {"cauchy": 2.0}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("loops: {topk: 3}", "unknown key 'loops.topk'; did you mean 'top_k'?"),
        ("modle: x", "unknown key 'modle'; did you mean 'model'?"),
        ("zzz: 1", "unknown key 'zzz'; known: model, seed, "),
        ("seed: many", "key 'seed': found 'many', input should be a valid integer"),
        ("keyframes: {distance_m: -1}", "key 'keyframes.distance_m': found -1, "),
        ("keyframes: {policy: often}", "key 'keyframes.policy': found 'often', "),
        ("cloud: {min_range_m: 9}", "min_range_m must be below max_range_m"),
        ("sensor: {max_depth_m: 0.05}", "min_depth_m must be below max_depth_m"),
        ("odometry: {options: {}}", "key 'odometry.name': "),
        ("- a\n- b", "found a list, expected keys and values"),
        ("a: [1", "not a YAML file: "),
        ("a: \x00", "not a YAML file: "),
    ],
)
def test_mistakes_are_one_line_with_file_and_key(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "wrong.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        config.load(file)
    said = str(caught.value)
    assert said.startswith(f"{file}: ")
    assert message in said
    assert "\n" not in said


def test_missing_and_unreadable_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.yaml: no such file, expected a YAML"):
        config.load(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match=re.escape(f"{tmp_path}: found Is a directory")):
        config.load(tmp_path)
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(ConfigError, match=r"binary\.yaml: not a YAML file"):
        config.load(tmp_path / "binary.yaml")


def test_unknown_preset_suggests_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"no preset 'indor'; did you mean 'indoor'\?"):
        config.preset("indor")
    with pytest.raises(ConfigError, match="no preset 'moon'; known: indoor, paper"):
        config.resolve("moon")


def test_resolve_takes_a_preset_or_a_file(tmp_path: Path) -> None:
    file = tmp_path / "my.yaml"
    file.write_text("seed: 7")
    assert config.resolve(str(file)).seed == 7
    assert config.resolve("paper") == config.preset("paper")


def test_override_sets_nested_keys_without_changing_the_original() -> None:
    base = Config()
    changed = config.override(
        base,
        ["loops.top_k=3", "backend.options.cauchy=2.5", "odometry=mine", "model=a=b.bof"],
    )
    assert changed.loops.top_k == 3
    assert changed.backend == PluginChoice(name="gtsam", options={"cauchy": 2.5})
    assert changed.odometry.name == "mine"
    assert changed.model == "a=b.bof"
    assert base == Config()
    assert config.override(base, []) == base


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("seed", "found 'seed', expected KEY=VALUE"),
        ("=3", "found '=3', expected KEY=VALUE"),
        ("loops.topk=3", "--set: unknown key 'loops.topk'; did you mean 'top_k'?"),
        ("seed.x=3", "'seed' has no keys below it"),
        ("seed=[1", "'[1' is not a YAML value"),
    ],
)
def test_override_explains_mistakes(assignment: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        config.override(Config(), [assignment])
    assert message in str(caught.value)


def test_complete_looks_into_options() -> None:
    wrong = config.override(Config(), ["backend.options.cauchi=2"])
    with pytest.raises(ConfigError, match=r"'gtsam': unknown key 'cauchi'; did you mean 'cauchy'"):
        config.complete(wrong)
    with pytest.raises(PluginError, match="no datasets plug-in 'kitti'"):
        config.complete(config.override(Config(), ["dataset=kitti"]))


def test_configurations_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="frozen"):
        Config().seed = 3  # type: ignore[misc]


def test_sections_given_in_part_keep_their_own_defaults(tmp_path: Path) -> None:
    file = tmp_path / "some.yaml"
    file.write_text(
        "tracking: {alignment: {n_iterations: 5}}\n"
        "loops: {recogniser: {alignment: {n_rounds: 2}}}\n"
        "verifier: {name: projective, options: {alignment: {n_iterations: 9}}}\n"
    )
    given, reference = config.complete(config.load(file)), config.complete(config.preset("indoor"))
    tracking = reference.tracking.alignment.model_copy(update={"n_iterations": 5})
    assert tracking.n_points != AlignmentParams().n_points
    assert given.tracking.alignment == tracking
    recogniser = reference.loops.recogniser.alignment.model_copy(update={"n_rounds": 2})
    assert given.loops.recogniser.alignment == recogniser
    found, expected = given.verifier.options, reference.verifier.options
    assert found == {**expected, "alignment": {**expected["alignment"], "n_iterations": 9}}


def test_a_data_set_takes_options() -> None:
    assert config.override(Config(), ["dataset=tum"]).dataset == PluginChoice(name="tum")
    chosen = config.override(Config(), ["dataset.name=tum", "dataset.options.camera=infrared"])
    assert config.complete(chosen).dataset.options["camera"] == "infrared"
    assert config.complete(Config()).dataset == PluginChoice(name="auto")
    wrong = config.override(Config(), ["dataset.name=tum", "dataset.options.camra=x"])
    with pytest.raises(ConfigError, match="unknown key 'camra'; did you mean 'camera'"):
        config.complete(wrong)
    with pytest.raises(PluginError, match="no datasets plug-in 'tmu'"):
        config.complete(config.override(Config(), ["dataset=tmu"]))


@pytest.mark.parametrize(
    ("text", "key", "name"),
    [
        ("tracking: {less: 0.1}", "tracking.less", "max_inlier_drop"),
        ("verification: {joining: {n_required: 2}}", "verification.joining", "component_joining"),
        ("verifier: {name: projective, options: {alignment: {rest: 0}}}", "verifier", "min_step"),
    ],
)
def test_a_key_of_an_earlier_version_is_refused_with_its_new_name(text, key, name):
    with pytest.raises(ConfigError, match=f"my.yaml: unknown key '{key}.*its name is now '{name}'"):
        config.parse(text, "my.yaml")


def test_a_saved_configuration_of_an_earlier_version_is_read_by_its_new_names():
    saved = config.parse_saved(
        "tracking: {less: 0.15, alignment: {rest: 0.002}}\n"
        "verification: {joining: {max_blocking: 0.1, near_m: 2.0}}\n"
        "verifier: {name: projective, options: {max_blocking: 0.3}}\n",
        "map.db",
    )
    assert saved.tracking.max_inlier_drop == 0.15
    assert saved.tracking.alignment.min_step == 0.002
    assert saved.verification.component_joining.max_free_space_violation == 0.1
    assert saved.verification.component_joining.max_pair_distance_m == 2.0
    assert saved.verifier.options == {"max_free_space_violation": 0.3}


def test_every_renamed_key_exists_under_its_new_name():
    dumped = config.dump(config.complete(config.preset("indoor")))
    for name in config.RENAMED_KEYS.values():
        assert re.search(rf"^ *{name}:", dumped, re.MULTILINE), name


def test_a_saved_map_may_have_a_key_that_never_had_an_effect():
    text = "loops: {recogniser: {search: {matching: {min_score_ratio: 0.7, max_slices: 1}}}}"
    saved = config.parse_saved(text, "map.db")
    assert saved.loops.recogniser.search.matching.max_slices == 1
    with pytest.raises(ConfigError, match=r"matching\.min_score_ratio"):
        config.parse(text, "my.yaml")


def test_a_saved_map_may_have_keys_of_what_was_removed():
    search = "{by: both, n_voted: 200, n_compared: 40, constellation_weight: 3.0, index: {}}"
    recogniser = f"{{n_plans: 100, plan_weight: 0.5, n_aligned: 7, search: {search}}}"
    text = f"loops: {{recogniser: {recogniser}}}"
    removed = "tracking: {spread_search: true}\nlabels: {new_view_weight: 0.15}"
    saved = config.parse_saved(f"{text}\n{removed}", "map.db")
    assert saved.loops.recogniser.n_aligned == 7
    assert saved.loops.recogniser.search.n_compared == 40
    with pytest.raises(ConfigError, match=r"loops\.recogniser\.search\.by"):
        config.parse(text, "my.yaml")
