"""The diesel's right-hand side without jax, for the comparison with scipy."""

import dataclasses
import math
from typing import Any

import numpy as np


class PlainDiesel:
    """The right-hand side of `Diesel` on Python floats, for a solver without arrays.

    Equations of J. Wahlström and L. Eriksson 2011, as in `Diesel.quantities`.
    """

    def __init__(self, engine: Any):
        names = (field.name for field in dataclasses.fields(engine))
        self.p = {name: float(getattr(engine, name)) for name in names}

    def __call__(self, state: Any, inputs: Any) -> Any:
        p = self.p
        p_im, p_em, x_im, x_em, w, e1, e2, v = (float(s) for s in state)
        fuel, egr_command, vgt_command, speed = (float(u) for u in inputs)
        p_im, p_em, w = max(p_im, 1e4), max(p_em, 1e4), max(w, 50.0)
        gas = p["gas_constant"] * p["intake_temperature"]
        filling = p["filling_pressure"] * math.sqrt(p_im)
        filling += p["filling_speed"] * math.sqrt(speed) + p["filling_constant"]
        air = filling * p_im * speed * p["displacement"] / (120 * gas)
        burnt = max(1e-6 / 120 * fuel * speed * p["cylinders"], 1e-9)
        out = air + burnt
        needed = burnt * p["stoichiometric"] * p["fresh_oxygen"]
        left = max((air * x_im - needed) / out, 0.0)
        hot = self._temperature(p_em / p_im, burnt, air)
        root = math.sqrt(hot * p["exhaust_gas_constant"])
        egr = self._egr(e1, e2, p_im, p_em, root)
        turbine, gained = self._turbine(v, p_em, hot, root, w)
        compressor, spent = self._compressor(p_im, w)
        cold = gas / p["intake_volume"]
        warm = p["exhaust_gas_constant"] * hot / p["exhaust_volume"]
        mixing = (x_em - x_im) * egr + (p["fresh_oxygen"] - x_im) * compressor
        return np.array(
            [
                cold * (compressor + egr - air),
                warm * (out - turbine - egr),
                cold / p_im * mixing,
                warm / p_em * (left - x_em) * out,
                (gained - spent) / (p["turbo_inertia"] * w),
                (egr_command - e1) / p["egr_time"],
                (egr_command - e2) / p["egr_slow_time"],
                (vgt_command - v) / p["vgt_time"],
            ]
        )

    def _temperature(self, ratio: float, burnt: float, air: float) -> float:
        p = self.p
        lift = p["compression"] ** (p["gamma_a"] - 1)
        release = burnt * p["heating_value"] / ((burnt + air) * p["heat_capacity"])
        emptied = ratio ** (1 / p["gamma_a"])
        cooling = p["cycle_factor"] * ratio / emptied / lift
        residual, start, hot = 0.0, p["intake_temperature"], 0.0
        for _ in range(6):
            heat = release * (1 - residual)
            burning = 1 + heat / (start * lift)
            residual = min(max(emptied / (p["compression"] * burning), 0.0), 1.0)
            hot = cooling * (heat + start * lift)
            start = residual * hot + (1 - residual) * p["intake_temperature"]
            start = max(start, 273.0)
        area = math.pi * p["pipe_diameter"] * p["pipe_length"] * p["pipes"]
        kept = (burnt + air) * p["exhaust_heat_capacity"]
        wall = p["wall_temperature"]
        return wall + (hot - wall) * math.exp(-p["heat_transfer"] * area / kept)

    def _egr(
        self, e1: float, e2: float, p_im: float, p_em: float, root: float
    ) -> float:
        p = self.p
        u = p["egr_overshoot"] * e1 - (p["egr_overshoot"] - 1) * e2
        u = min(u, -p["egr_linear"] / (2 * p["egr_quadratic"]))
        opening = (p["egr_quadratic"] * u + p["egr_linear"]) * u + p["egr_constant"]
        ratio = min(max(p_im / p_em, p["egr_ratio"]), 1.0)
        share = 1 - ((1 - ratio) / (1 - p["egr_ratio"]) - 1) ** 2
        return p["egr_area"] * max(opening, 0.0) * p_em / root * share

    def _turbine(
        self, v: float, p_em: float, hot: float, root: float, w: float
    ) -> tuple[float, float]:
        p = self.p
        circle = max(1 - ((v - p["vgt_centre"]) / p["vgt_width"]) ** 2, 0.0)
        opening = max(p["vgt_offset"] + p["vgt_gain"] * math.sqrt(circle), 0.0)
        ratio = min(p["ambient_pressure"] / p_em, 0.9999)
        flow = p["vgt_area"] * p_em * opening / root
        flow *= math.sqrt(1 - ratio ** p["vgt_exponent"])
        energy = p["exhaust_heat_capacity"] * hot
        energy *= 1 - ratio ** (1 - 1 / p["gamma_e"])
        blade = p["turbine_radius"] * w / math.sqrt(2 * energy)
        blade = min(blade, 2 * p["blade_ratio"])
        if w >= p["blade_linear_end"]:
            steep = p["blade_gain"] * (w - p["blade_start"]) ** p["blade_power"]
        else:
            span = p["blade_linear_end"] - p["blade_start"]
            steep = p["blade_linear_gain"] * max(w - p["blade_start"], 0.0) / span
        efficiency = p["turbine_best"] - steep * (blade - p["blade_ratio"]) ** 2
        return flow, flow * energy * min(max(efficiency, 0.2), 1.0)

    def _compressor(self, p_im: float, w: float) -> tuple[float, float]:
        p = self.p
        ratio = max(p_im / p["ambient_pressure"], 1.0)
        lift = p["heat_capacity"] * p["ambient_temperature"]
        lift *= ratio ** (1 - 1 / p["gamma_a"]) - 1
        head = 2 * lift / (p["compressor_radius"] * w) ** 2
        steep = (p["head_quadratic"] * w + p["head_linear"]) * w + p["head_constant"]
        wide = (p["flow_quadratic"] * w + p["flow_linear"]) * w + p["flow_constant"]
        inside = max((1 - max(steep, 0.0) * head**2) / max(wide, 0.1), 0.0)
        flow = p["ambient_pressure"] / (p["gas_constant"] * p["ambient_temperature"])
        flow *= math.pi * p["compressor_radius"] ** 3 * w * math.sqrt(inside)
        flow = max(flow, 1e-4)
        a = flow - p["best_flow"]
        excess = max(ratio - 1 + p["ratio_softening"], 0.0)
        b = excess ** p["ratio_power"] - p["best_ratio"]
        loss = p["loss_flow"] * a**2 + 2 * p["loss_cross"] * a * b
        loss += p["loss_ratio"] * b**2
        return flow, flow * lift / max(p["compressor_best"] - loss, 0.2)
