"""The adjoint (VJP) of one step of the prediction, from p(x_{t+1}) back to p(x_t)."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_pmil.control.state_space import StateSpace
from torch_pmil.gp.gaussian import Gaussian, symmetric
from torch_pmil.gp.moment_derivatives import MomentDerivatives
from torch_pmil.gp.trigonometry import augment_adjoint, squash, squash_adjoint

Cotangents = tuple[Tensor, Tensor, Tensor]


class StepDerivatives:
    """Derivatives of :func:`predict_step` at N beliefs.

    Args:
        state: the beliefs, mean (N, D).
        network: the policy's moments and their Jacobian at the features of the state.
        u_max: torque limits (F,).
        model: the model's moments and their Jacobian at the features and actions.
        differences: whether the model predicts changes of the state, or the next state itself.
        space: the robot's state space.
    """

    def __init__(
        self,
        state: Gaussian,
        network: MomentDerivatives,
        u_max: Tensor,
        model: MomentDerivatives,
        differences: bool,
        space: StateSpace,
    ) -> None:
        self.network, self.model, self.u_max = network, model, u_max
        self.differences, self.augmentation = differences, space.augmentation
        self.features, slope = space.feature_moments(state)
        raw = network.moments
        _, gain = squash(raw.gaussian, u_max)
        # each has an axis of length one, over which C cotangents broadcast
        self.mean, self.cov = state.mean[:, None], state.cov[:, None]
        self.slope, self.features_cov = slope[:, None], self.features.cov[:, None]
        self.gain, self.raw_slope = gain[:, None], raw.inv_cov_cross_cov[:, None]
        self.action_slope = self.raw_slope * self.gain[..., None, :]
        self.raw = Gaussian(raw.mean[:, None], raw.cov[:, None])
        self.input_slope = torch.cat([self.slope, self.slope @ self.action_slope], -1)
        self.model_slope = model.moments.inv_cov_cross_cov[:, None]

    def state_adjoint(self, d_mean: Tensor, d_cov: Tensor) -> tuple[Tensor, Tensor]:
        """Cotangents of the state, (N, C, D) and (N, C, D, D), from C cotangents of the next state.

        Cotangents of covariances are symmetric.
        """
        d_raw, d_features, d_state = self._back_to_policy(d_mean, d_cov)
        by_mean, by_cov = self.network.adjoint(*d_raw)
        d_features_mean, d_features_cov, d_slope = d_features
        d_state_mean, d_state_cov = augment_adjoint(
            self.augmentation,
            self.mean,
            self.cov,
            d_features_mean + by_mean,
            d_features_cov + by_cov,
            d_slope,
        )
        if not self.differences:
            return d_state_mean, d_state_cov
        return d_mean + d_state_mean, symmetric(d_state + d_state_cov)

    def network_adjoint(self, d_mean: Tensor, d_cov: Tensor) -> Cotangents:
        """Cotangents of the policy's moments before squashing, from those of the next state."""
        return self._back_to_policy(d_mean, d_cov)[0]

    def _back_to_policy(
        self, d_mean: Tensor, d_cov: Tensor
    ) -> tuple[Cotangents, Cotangents, Tensor]:
        """Cotangents of the policy's moments, of the features, and of the state's covariance.

        Those of the features are of their mean, covariance and slope. That of the state's
        covariance is the direct one alone, not through the features.
        """
        d_input_slope, d_model_slope, d_state_cov = self._of_cross_covariance(d_cov)
        by_mean, by_cov = self.model.adjoint(d_mean, d_cov, d_model_slope)
        D = self.features_cov.shape[-1]
        d_slope, d_slope_of_action = d_input_slope[..., :D], d_input_slope[..., D:]
        d_cross = 2 * by_cov[..., :D, D:]
        d_action_slope = self.features_cov @ d_cross + self.slope.mT @ d_slope_of_action
        d_features_cov = by_cov[..., :D, :D] + symmetric(d_cross @ self.action_slope.mT)
        d_gain = (d_action_slope * self.raw_slope).sum(-2)
        d_raw = squash_adjoint(self.raw, self.u_max, by_mean[..., D:], by_cov[..., D:, D:], d_gain)
        d_features = (
            by_mean[..., :D],
            d_features_cov,
            d_slope + d_slope_of_action @ self.action_slope.mT,
        )
        return (*d_raw, d_action_slope * self.gain[..., None, :]), d_features, d_state_cov

    def _of_cross_covariance(self, d_cov: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Cotangents of input_slope, model_slope and Sigma through Sigma + S + C + C'.

        C = Sigma input_slope model_slope. All are zero where the model predicts the next state.
        """
        if not self.differences:
            zero = d_cov.new_zeros(())
            return (
                zero.expand(*d_cov.shape[:-2], *self.input_slope.shape[-2:]),
                zero.expand(*d_cov.shape[:-2], *self.model_slope.shape[-2:]),
                zero,
            )
        d_C = 2 * d_cov
        by_product = self.cov @ d_C
        d_state_cov = d_cov + d_C @ (self.input_slope @ self.model_slope).mT
        return by_product @ self.model_slope.mT, self.input_slope.mT @ by_product, d_state_cov
