"""The state of a robot, its features, and the policies that act on it.

Six classes are policies, each at another level:

=================  =====================  ========================================================
class              of                     acts on
=================  =====================  ========================================================
``Controller``     ``rbf_policy``         features, or a belief over them: the network of Eqs.
                                          25-27 at given parameters
``RBFPolicy``      ``rbf_policy``         features (*batch, D'): the module whose parameters are
                                          searched
``StatePolicy``    ``state_policy``       states (*batch, D): the policy that runs on a robot and
                                          is saved
``RobotActor``     ``trainer.collector``  states, as the exploration at first and as the policy
                                          from the first search on
``BeliefPolicy``   ``torchrl_interop``    TensorDicts of beliefs, in TorchRL's imagined
                                          environments
``Policy``         ``rbf_policy``         nothing itself: the protocol of whatever gives a
                                          ``Controller`` to a prediction
=================  =====================  ========================================================
"""
