// The paper's full system by Boost odeint, for `solvers.py` to call through ctypes.
//
// g++ -O3 -march=native -shared -fPIC -o odeint.so odeint.cpp

#include <array>
#include <boost/numeric/odeint.hpp>
#include <cmath>
#include <cstddef>

namespace odeint = boost::numeric::odeint;
using State = std::array<double, 4>;  // x, y, u, v

// (2.8)-(2.9) as in `solvers.body`, under a wind linear between equally spaced knots.
struct Body {
    double epsilon;
    const double* wind;  // (intervals + 1, 2)
    std::size_t intervals;
    std::size_t* evaluations;

    void operator()(const State& state, State& rate, double t) const {
        ++*evaluations;
        const auto [x, y, u, v] = state;
        const double omega = 2 * M_PI / epsilon, slow = 6 * M_PI * t;
        const double sin1 = std::sin(omega * t), cos1 = std::cos(omega * t);
        const double sin_slow = std::sin(slow), cos_slow = std::cos(slow);
        const double a = 2 + sin_slow, a_rate = 6 * M_PI * cos_slow;
        const double b = 2 + cos_slow, b_rate = -6 * M_PI * sin_slow;
        const double wave = sin1 + sin1 * cos1 / 2;
        const double wave_rate = omega * (cos1 + 0.5 - sin1 * sin1);
        const double tide = a * x, tide_change = a_rate * x + a * u;
        const double residual =
            epsilon * (omega * b * y * cos1 + (b_rate * y + b * v) * sin1);
        const std::size_t knot = std::min(std::size_t(t * intervals), intervals - 1);
        const double part = t * intervals - knot;
        const double* w = wind + 2 * knot;
        rate = {u, v,
                tide * wave_rate + tide_change * wave + residual
                    + w[0] + part * (w[2] - w[0]) - u,
                (tide * omega * cos1 + tide_change * sin1) / 2 + residual
                    + w[1] + part * (w[3] - w[1]) - v};
    }
};

// winds (members, intervals + 1, 2) -> positions (members, 2) at t = 1; gives the evaluations of
// the right-hand side. Dormand-Prince of the tolerance given, or for 0 RK4 on the knots.
extern "C" std::size_t solve(double epsilon, double tolerance, const double* winds,
                             std::size_t members, std::size_t intervals, double* positions) {
    std::size_t evaluations = 0;
    for (std::size_t m = 0; m < members; ++m) {
        const Body body{epsilon, winds + 2 * (intervals + 1) * m, intervals, &evaluations};
        State state{1, 1, 0, 0};
        const double step = 1.0 / intervals;
        if (tolerance > 0) {
            auto stepper = odeint::make_controlled<odeint::runge_kutta_dopri5<State>>(
                tolerance, tolerance);
            odeint::integrate_adaptive(stepper, body, state, 0.0, 1.0, step);
        } else {
            odeint::integrate_n_steps(odeint::runge_kutta4<State>(), body, state, 0.0, step,
                                      intervals);
        }
        positions[2 * m] = state[0];
        positions[2 * m + 1] = state[1];
    }
    return evaluations;
}
