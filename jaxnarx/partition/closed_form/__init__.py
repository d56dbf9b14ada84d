"""Networks whose regions share stable feedback: the free run in closed form.

    A(q) y(t) = sum_m phi_m(z_t) sum_k theta[m, k] p_k(u_t)

With A given the free run is linear in theta, so the simulation error has normal
equations. They add over records, and leaving a group of records out costs one small
solve and no pass over the data.
"""
