"""The file of a policy: what comes back, and what is refused."""

from __future__ import annotations

import os
import pickle
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from tests.helpers.draws import Draws
from tests.helpers.hostile import Trap, members_of, write_members
from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.policy_file import PolicyFileError, load_policy, save_policy
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_space import StateSpace, joint_match

NAMES, UNITS = ("x", "q", "dx", "dq"), ("m", "rad", "m/s", "rad/s")
SPACE = StateSpace(NAMES, UNITS, (1,), joint_match(NAMES, UNITS))
LOW, HIGH = torch.tensor([-3.5, -1.0]), torch.tensor([3.5, 3.0])
ACTIONS = ActionSpace(("force", "angle"), ("N", "rad"), LOW, HIGH)
PARAMETERS = "parameters must be centres, weights, log_widths, u_max, u_middle, scale"


@pytest.fixture
def policy(draws: Draws) -> RBFPolicy:
    u_max, u_middle = torch.tensor([[3.5, 2.0], [0.0, 1.0]])
    policy = RBFPolicy(draws.normal(7, 5), u_max, draws.uniform(0.5, 2.0, 5), u_middle)
    policy.weights.data.copy_(draws.normal(7, 2))
    policy.log_widths.data.copy_(0.3 * draws.normal(2, 5))
    return policy


@pytest.fixture
def path(policy: RBFPolicy, tmp_path: Path) -> Path:
    save_policy(tmp_path / "policy.pt", policy, SPACE, control_period=0.1, actions=ACTIONS)
    return tmp_path / "policy.pt"


def error_of(path: Path) -> str:
    """The one line that loading fails with, after the name of the file."""
    with pytest.raises(PolicyFileError) as error:
        load_policy(path)
    message = str(error.value)
    assert message.startswith(f"{path}: ") and "\n" not in message
    return message.removeprefix(f"{path}: ")


def edited(path: Path, **entries: object) -> Path:
    """The file with other entries; None takes one out."""
    content = torch.load(path, weights_only=True) | entries
    torch.save({name: value for name, value in content.items() if value is not None}, path)
    return path


def with_parameters(path: Path, **parameters: object) -> Path:
    """The file with other parameters; None takes one out."""
    changed = torch.load(path, weights_only=True)["parameters"] | parameters
    kept = {name: value for name, value in changed.items() if value is not None}
    return edited(path, parameters=kept)


@torch.no_grad()
def test_loaded_policy_acts_at_states_as_the_saved_one_at_their_features(
    policy: RBFPolicy, path: Path, draws: Draws
) -> None:
    states = draws.normal(20, 4)
    assert torch.equal(load_policy(path)(states), policy(SPACE.features(states)))


def test_every_parameter_comes_back_bit_for_bit(policy: RBFPolicy, path: Path) -> None:
    loaded = load_policy(path).policy.state_dict()
    assert loaded.keys() == policy.state_dict().keys()
    assert all(torch.equal(loaded[name], value) for name, value in policy.state_dict().items())


def test_loaded_policy_knows_state_period_and_actions_and_has_no_gradient(path: Path) -> None:
    loaded = load_policy(str(path))
    assert (loaded.space.names, loaded.space.units, loaded.space.angles) == (NAMES, UNITS, (1,))
    assert loaded.control_period == 0.1
    assert str(loaded.actions) == "force (N) from -3.5 to 3.5, angle (rad) from -1 to 3"
    assert not any(parameter.requires_grad for parameter in loaded.parameters())


def as_version_1(path: Path, **parameters: object) -> Path:
    """The file as it was before actions had names, units and a middle."""
    with_parameters(path, u_middle=None, **parameters)
    return edited(path, version=1, action_names=None, action_units=None)


def test_file_of_version_1_holds_torques_around_zero(
    path: Path, policy: RBFPolicy, draws: Draws
) -> None:
    loaded, states = load_policy(as_version_1(path)), draws.normal(20, 4)
    assert str(loaded.actions) == "0 (N·m) from -3.5 to 3.5, 1 (N·m) from -2 to 2"
    middle = torch.tensor([0.0, 1.0], dtype=torch.float64)
    torch.testing.assert_close(loaded(states), policy(SPACE.features(states)).detach() - middle)


@pytest.mark.parametrize("u_max", [None, [3.5], torch.ones(1).double().expand(10**8)])
def test_file_of_version_1_without_limits_is_refused(path: Path, u_max: object) -> None:
    assert error_of(as_version_1(path, u_max=u_max)).startswith("format version must be 2, got 1")


def test_file_is_read_without_executing_anything_and_says_what_it_is(path: Path) -> None:
    content = torch.load(path, weights_only=True)
    assert (content["format"], content["version"]) == ("torch_pmil policy", 2)
    assert content["torch_pmil"]
    assert content["parameters"]["u_max"].tolist() == [3.5, 2.0]


def test_saving_replaces_a_file_and_leaves_nothing_else(path: Path, policy: RBFPolicy) -> None:
    with torch.no_grad():
        policy.weights.zero_()
    save_policy(path, policy, SPACE, control_period=0.2)
    assert load_policy(path).control_period == 0.2
    assert not load_policy(path).policy.weights.any()
    assert os.listdir(path.parent) == ["policy.pt"]


def test_policy_of_other_features_is_refused_before_there_is_a_file(tmp_path: Path) -> None:
    other = RBFPolicy(torch.zeros(3, 4), torch.ones(1), torch.ones(4))
    message = "policy must see the features x, dx, dq, sin q, cos q, got one of 4 features"
    with pytest.raises(ValueError, match=message):
        save_policy(tmp_path / "policy.pt", other, SPACE, control_period=0.1)
    assert os.listdir(tmp_path) == []


def test_missing_folder_and_missing_file_are_oserrors(policy: RBFPolicy, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        save_policy(tmp_path / "nowhere" / "policy.pt", policy, SPACE, 0.1)
    with pytest.raises(FileNotFoundError):
        load_policy(tmp_path / "policy.pt")


def test_bare_parameters_of_an_older_run_are_refused(policy: RBFPolicy, tmp_path: Path) -> None:
    torch.save(policy.state_dict(), tmp_path / "policy.pt")
    found = "got entries centres, weights, log_widths, u_max, u_middle"
    assert error_of(tmp_path / "policy.pt").endswith(f"format = 'torch_pmil policy', {found}")


@pytest.mark.parametrize(
    ("content", "found"),
    [
        ([1.0], "a list"),
        (torch.zeros(3), "a Tensor"),
        ({}, "entries none"),
        ({"format": "other"}, "entries format"),
    ],
)
def test_other_files_of_torch_are_refused(tmp_path: Path, content: object, found: str) -> None:
    torch.save(content, tmp_path / "policy.pt")
    assert error_of(tmp_path / "policy.pt").endswith(f"'torch_pmil policy', got {found}")


def test_other_version_is_refused_with_its_writer(path: Path) -> None:
    edited(path, version=3, torch_pmil="9.1.0", names=None)
    assert error_of(path) == "format version must be 2, got 3, written by torch_pmil 9.1.0"


@pytest.mark.parametrize(
    "content",
    [b"", b"demonstration,time,x\n", bytes(1000), pickle.dumps({"format": "torch_pmil policy"})],
)
def test_files_that_torch_cannot_read_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "policy.pt").write_bytes(content)
    message = "must be a file of save_policy: must be a whole ZIP archive, got"
    assert error_of(tmp_path / "policy.pt").startswith(message)


def test_other_zip_archives_are_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "policy.pt", "w") as archive:
        archive.writestr("positions.npy", b"123")
    assert "torch.load cannot read" in error_of(tmp_path / "policy.pt")


def test_code_in_a_file_is_refused_and_not_run(path: Path, tmp_path: Path) -> None:
    edited(path, names=Trap(tmp_path / "sprung"))
    assert error_of(path).endswith("data.pkl must name tensors alone, got posix mkdir")
    assert os.listdir(tmp_path) == ["policy.pt"]


def with_pickle(path: Path, change: Callable[[bytes], bytes]) -> Path:
    members = members_of(path)
    name = next(name for name in members if name.endswith("data.pkl"))
    write_members(path, {**members, name: change(members[name])})
    return path


def test_pickle_that_asks_for_memory_is_refused(path: Path) -> None:
    """``torch.load`` would make these 10^10 bytes."""
    pickled = b"\x80\x02cbuiltins\nbytearray\n\x8a\x05\x00\xe4\x0bT\x02\x85R."
    assert error_of(with_pickle(path, lambda old: pickled)).endswith("got builtins bytearray")


def test_key_that_takes_forever_to_hash_is_refused(path: Path) -> None:
    """Tuples of two tuples each, sixty deep."""
    doubled = b"".join(b"q%ch%c\x86" % (depth, depth) for depth in range(60))
    pickled = b"\x80\x02}K\x00\x85" + doubled + b"K\x01s."
    assert error_of(with_pickle(path, lambda old: pickled)).endswith("got one twice")


def test_entry_that_takes_forever_to_show_is_refused_in_one_line(path: Path) -> None:
    names: list = []
    for _ in range(60):
        names = [names, names]
    assert len(error_of(edited(path, names=names))) < 2000


def test_dictionary_that_lies_about_its_methods_is_read_by_its_entries(path: Path) -> None:
    content = OrderedDict(torch.load(path, weights_only=True))
    content.get = content.keys = None  # type: ignore[method-assign]
    torch.save(content, path)
    assert load_policy(path).space.names == NAMES


def test_version_that_is_no_number_is_named(path: Path) -> None:
    file = edited(path, version=torch.tensor([1, 1]))
    assert "format version must be 2, got tensor([1, 1])" in error_of(file)


def test_packed_file_is_refused_before_it_is_unpacked(path: Path) -> None:
    members = members_of(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    assert "members must be stored as they are, got 'archive/" in error_of(path)


def test_one_wrong_bit_of_a_parameter_is_refused(path: Path, policy: RBFPolicy) -> None:
    """torch.load would take it."""
    data = bytearray(path.read_bytes())
    data[bytes(data).index(policy.weights.detach().numpy().tobytes()) + 6] ^= 1
    path.write_bytes(data)
    taken = torch.load(path, weights_only=True)["parameters"]["weights"]
    assert not torch.equal(taken, policy.weights)
    assert "got: Bad CRC-32 for file 'archive/data/1'" in error_of(path)


def test_damage_anywhere_is_refused_or_changes_nothing(
    path: Path, policy: RBFPolicy, draws: Draws
) -> None:
    whole, refused = path.read_bytes(), 0
    for place in torch.randint(len(whole), (300,), generator=draws.generator).tolist():
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 255]) + whole[place + 1 :])
        try:
            loaded = load_policy(path)
        except PolicyFileError:
            refused += 1
        else:
            space, values = loaded.space, loaded.policy.state_dict()
            assert (space.names, space.angles, loaded.control_period) == (NAMES, (1,), 0.1)
            saved = policy.state_dict()
            assert all(torch.equal(value, saved[name]) for name, value in values.items())
    assert refused > 100


WRONG_ENTRIES = [
    ({"names": "x"}, "entry names must be a list of str, got 'x'"),
    ({"names": None}, "entry names must be a list of str, got None"),
    ({"units": [1, 2, 3, 4]}, "entry units must be a list of str, got [1, 2, 3, 4]"),
    ({"units": ["m"]}, "entry units must hold one for each of names ['x', 'q', 'dx', 'dq'], got"),
    ({"action_units": ["m"]}, "entry action_units must hold one for each of action_names ['force'"),
    ({"action_names": ["u", "u"]}, "names of actions must be different, got ('u', 'u')"),
    ({"action_names": ["u"], "action_units": ["m"]}, "low must have shape (1,), got (2,)"),
    ({"angles": [True]}, "entry angles must be a list of int, got [True]"),
    ({"angles": [4]}, "angles must be indices below 4, got (4,)"),
    ({"angles": []}, "parameter centres must have shape (7, 4), got (7, 5)"),
    ({"names": [], "units": [], "angles": []}, "names must be those of one entry at least, got"),
    ({"control_period": "0.1"}, "entry control_period must be a float, got '0.1'"),
    ({"control_period": float("nan")}, "control_period (s) must be a positive finite number, got"),
    ({"parameters": None}, "entry parameters must be a dict of tensors, got NoneType"),
    ({"parameters": {}}, f"{PARAMETERS}, got none"),
]


@pytest.mark.parametrize(("entries", "complaint"), WRONG_ENTRIES)
def test_entries_that_are_wrong_or_do_not_fit_are_named(
    path: Path, entries: dict[str, object], complaint: str
) -> None:
    assert error_of(edited(path, **entries)).startswith(complaint)


def full(value: float, *shape: int) -> torch.Tensor:
    return torch.full(shape, value, dtype=torch.float64)


WIDTHS = "widths must have squares that are positive and finite, got log_widths = "
WRONG_PARAMETERS = [
    ({"weights": full(0, 6, 2)}, "parameter centres must have shape (6, 5), got (7, 5)"),
    (
        {"weights": full(0, 0, 2), "centres": full(0, 0, 5)},
        "a policy must have centres, inputs and actions, got 0, 5 and 2",
    ),
    ({"log_widths": full(1e4, 2, 5)}, f"{WIDTHS}10000"),
    ({"log_widths": full(-1e4, 2, 5)}, f"{WIDTHS}-10000"),
    ({"centres": full(1e200, 7, 5)}, "centres must have finite squares, got "),
    ({"centres": full(0, 1).expand(7, 5)}, "parameter centres must hold its numbers, got one rep"),
    ({"weights": full(0)}, "parameter centres must have shape (0, 5), got (7, 5)"),
    ({"log_widths": full(0, 5, 2)}, "parameter log_widths must have shape (2, 5), got (5, 2)"),
    ({"scale": torch.ones(5)}, "parameter scale must be a float64 tensor, got torch.float32"),
    ({"scale": full(-1, 5)}, "scale must be positive, got -1"),
    ({"u_max": full(0, 2)}, "u_max must be positive, got 0"),
    ({"u_max": [3.5, 2.0]}, "parameter u_max must be a float64 tensor, got list"),
    ({"centres": full(torch.nan, 7, 5)}, "parameter centres must be finite, got nan"),
    ({"weights": None}, f"{PARAMETERS}, got centres, log_widths"),
    ({"other": torch.zeros(1)}, f"{PARAMETERS}, got centres, weights"),
]


@pytest.mark.parametrize(("parameters", "complaint"), WRONG_PARAMETERS)
def test_parameters_that_are_wrong_or_do_not_fit_are_named(
    path: Path, parameters: dict[str, object], complaint: str
) -> None:
    assert error_of(with_parameters(path, **parameters)).startswith(complaint)
