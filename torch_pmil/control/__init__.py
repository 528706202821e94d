"""The state of a robot, its features, and the policies that act on it.

Six classes are policies, each at another level:

=================  =====================  ========================================================
class              of                     acts on
=================  =====================  ========================================================
``Controller``     ``rbf_policy``         features or beliefs over them (Eqs. 25-27)
``RBFPolicy``      ``rbf_policy``         features (*batch, D'), with parameters to search
``StatePolicy``    ``state_policy``       states (*batch, D); it runs on a robot and is saved
``RobotActor``     ``trainer.collector``  states: exploration first, then the policy
``BeliefPolicy``   ``torchrl_interop``    TensorDicts of beliefs, in TorchRL's imagined environments
``Policy``         ``rbf_policy``         nothing: the protocol of what gives a ``Controller``
=================  =====================  ========================================================
"""
