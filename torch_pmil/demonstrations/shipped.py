"""The demonstrations that come with the package."""

from __future__ import annotations

from importlib import resources

from torch_pmil.demonstrations.dataset import Demonstrations
from torch_pmil.demonstrations.errors import DemonstrationError
from torch_pmil.demonstrations.loading import load_demonstrations


def shipped_demonstrations(name: str = "double_pendulum") -> Demonstrations:
    """The demonstrations that come with the package.

    Args:
        name: of what was demonstrated:
            ``"double_pendulum"``: five swing-ups, positions [x1, y1, x2, y2] in m, at 10 Hz from 0
            to 2.5 s; ``"double_pendulum_targets"``: three motions to each of three places of the
            tip, their targets [x, y] in m, positions and times as those of the swing-ups;
            ``"gym_pendulum"``: five swing-ups of gymnasium's Pendulum-v1, its tip [x, y] in m, at
            10 Hz from 0 to 4 s; ``"inverted_pendulum"``: ten recoveries of gymnasium's
            InvertedPendulum-v5, [x_cart, x_tip, z_tip] in m, at 25 Hz from 0 to 2 s;
            ``"pendubot"``: five swing-ups by the motor in the shoulder, positions [x1, y1, x2, y2]
            in m, at 25 Hz from 0 to 3 s; ``"acrobot"``: the same by the motor in the elbow;
            ``"cart_pole"``: five swing-ups of a pole on a cart, [x_cart, x_tip, z_tip] in m, at 10
            Hz from 0 to 3 s;
            ``"biorob"``:
            three strikes of the BioRob, led by hand and aligned in time, [q, dq] of yaw, shoulder
            and elbow in rad and rad/s, at 10 Hz from 0 to 1.8 s; ``"biorob_targets"``: six strikes
            of the BioRob, two at each of three balls, all led by hand and aligned in time, as
            those; targets are the balls' places [y, z] in the hitting plane, m.

    Returns:
        The demonstrations.

    Raises:
        DemonstrationError: there are none of that name.

    Example:
        >>> shipped_demonstrations().positions.shape
        torch.Size([5, 26, 4])
    """
    shipped = {
        file.name.removesuffix(".npz"): file
        for file in resources.files("torch_pmil.demonstrations").joinpath("data").iterdir()
    }
    shipped = {stem: file for stem, file in shipped.items() if file.name == f"{stem}.npz"}
    if name not in shipped:
        raise DemonstrationError(
            f"shipped demonstrations must be one of {sorted(shipped)}, got {name}"
        )
    with resources.as_file(shipped[name]) as path:
        return load_demonstrations(path)
