"""The state of a robot, its features, and the policies that act on it.

Eight classes are policies, each at another level:

=================  =====================  ========================================================
class              of                     acts on
=================  =====================  ========================================================
``Controller``     ``rbf_policy``         features or beliefs over them (Eqs. 25-27)
``RBFPolicy``      ``rbf_policy``         features (*batch, D'), with parameters to search
``LinearPolicy``   ``linear_policy``      the same, by linear feedback
``ModulePolicy``   ``module_policy``      the same, by any module of PyTorch
``StatePolicy``    ``state_policy``       states (*batch, D); it runs on a robot and is saved
``RobotActor``     ``trainer.collector``  states: exploration first, then the policy
``BeliefPolicy``   ``torchrl_interop``    TensorDicts of beliefs, in TorchRL's imagined environments
``Policy``         ``policy``             nothing: the protocol of what gives a ``Controller``
=================  =====================  ========================================================
"""
