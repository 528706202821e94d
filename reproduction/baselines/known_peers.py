"""All peers of our method, by their names."""

from __future__ import annotations

from reproduction.baselines.bco import BCO
from reproduction.baselines.ensemble_cem import EnsembleCEM
from reproduction.baselines.gaifo import GAIfO
from reproduction.baselines.gp_tracker import GPTracker
from reproduction.baselines.mc_pilco import MCPilco
from reproduction.baselines.peer import Peer

PEERS: dict[str, type[Peer]] = {
    peer.name: peer for peer in (GPTracker, EnsembleCEM, MCPilco, BCO, GAIfO)
}
