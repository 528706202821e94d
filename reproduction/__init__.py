"""The experiments of the paper and beyond it, each in the file of its name.

A file has the runs, the numbers and the figures of its experiment.
"""

from reproduction.ablation import ABLATION
from reproduction.biorob import BIOROB
from reproduction.biorob_history import BIOROB_HISTORY
from reproduction.box import BOX
from reproduction.delay_calibration import DELAY_CALIBRATION
from reproduction.double_pendulum_servo import DOUBLE_PENDULUM_SERVO
from reproduction.figure6 import FIGURE6
from reproduction.figure7a import FIGURE7A
from reproduction.figure7b import FIGURE7B
from reproduction.figure9 import FIGURE9
from reproduction.figure11 import FIGURE11
from reproduction.handwriting import HANDWRITING
from reproduction.hidden_motors import HIDDEN_MOTORS
from reproduction.imperfect import IMPERFECT
from reproduction.improvement import IMPROVEMENT_STUDY
from reproduction.masses import MASSES
from reproduction.noise import NOISE, NOISY_ROBOTS
from reproduction.own_parts import OWN_PARTS
from reproduction.peers import PEERS_STUDIES
from reproduction.pendubot import ACROBOT, PENDUBOT
from reproduction.pilco_gymnasium import PILCO_GYMNASIUM
from reproduction.pilco_scenarios import PILCO_CART_DOUBLE, PILCO_SCENARIOS
from reproduction.reaching import REACHING
from reproduction.remembering import DELAY, POSITIONS_ONLY
from reproduction.robot_server import ROBOT_SERVER
from reproduction.robustness import ROBUSTNESS
from reproduction.sensitivity import SENSITIVITY
from reproduction.servo_gains import SERVO_GAINS
from reproduction.ur5e import UR5E_CARRIES

PAPER = {
    experiment.name: experiment
    for experiment in (
        FIGURE6,
        FIGURE7A,
        FIGURE7B,
        MASSES,
        ROBUSTNESS,
        ABLATION,
        BOX,
        DELAY_CALIBRATION,
        FIGURE9,
        BIOROB,
        HIDDEN_MOTORS,
        FIGURE11,
        REACHING,
        HANDWRITING,
        ROBOT_SERVER,
        DOUBLE_PENDULUM_SERVO,
        SERVO_GAINS,
        UR5E_CARRIES,
        POSITIONS_ONLY,
        DELAY,
        BIOROB_HISTORY,
        NOISE,
        NOISY_ROBOTS,
        *PEERS_STUDIES,
        SENSITIVITY,
        PENDUBOT,
        ACROBOT,
        IMPERFECT,
        PILCO_SCENARIOS,
        PILCO_CART_DOUBLE,
        PILCO_GYMNASIUM,
        IMPROVEMENT_STUDY,
        OWN_PARTS,
    )
}
