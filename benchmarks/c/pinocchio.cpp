// pinocchio.cpp: Pinocchio's dynamics of a serial arm, called many times from C++.
//
// In: the number of calls and of joints; of each joint R (9), r (3), mass, centre (3), tensor about the
// centre (xx xy yy xz yz zz); then q, dq and tau. Out: a line for each algorithm with seconds a call, the
// least of some rounds, and the result.
#include <ctime>
#include <iostream>
#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/algorithm/rnea.hpp>
#include <pinocchio/multibody.hpp>
#include <string>

namespace pin = pinocchio;
using Vector = Eigen::VectorXd;

static Vector numbers(int n) {
    Vector found(n);
    for (int i = 0; i < n; i++) std::cin >> found[i];
    return found;
}

static pin::Model arm(int n) {
    pin::Model model;
    pin::JointIndex parent = 0;
    for (int i = 0; i < n; i++) {
        const Vector R = numbers(9), r = numbers(3), mass = numbers(1), c = numbers(3), I = numbers(6);
        Eigen::Matrix3d rotation, tensor;
        rotation << R[0], R[1], R[2], R[3], R[4], R[5], R[6], R[7], R[8];
        tensor << I[0], I[1], I[3], I[1], I[2], I[4], I[3], I[4], I[5];
        const pin::SE3 place(rotation, Eigen::Vector3d(r));
        parent = model.addJoint(parent, pin::JointModelRZ(), place, "joint" + std::to_string(i));
        const pin::Inertia body(mass[0], Eigen::Vector3d(c), tensor);
        model.appendBodyToJoint(parent, body, pin::SE3::Identity());
    }
    return model;
}

template <typename Call> static void measure(const char *name, int times, Vector q, Call call) {
    double least = 1e9;
    Vector first;
    for (int round = 0; round < 9; round++) {
        const std::clock_t start = std::clock();
        for (int i = 0; i < times; i++) {
            const Vector &found = call(q);
            if (first.size() == 0) first = found;
            q[0] += 1e-12 * found[found.size() - 1];
        }
        const double spent = double(std::clock() - start) / CLOCKS_PER_SEC / times;
        if (spent < least) least = spent;
    }
    std::cout.precision(17);
    std::cout << name << " " << least << " " << first.transpose() << "\n";
}

int main() {
    const Vector sizes = numbers(2);
    const int times = int(sizes[0]), n = int(sizes[1]);
    const pin::Model model = arm(n);
    pin::Data data(model);
    const Vector q = numbers(n), dq = numbers(n), tau = numbers(n);
    using pin::Convention;
    measure("local", times, q, [&](const Vector &x) -> const Vector & {
        return pin::aba(model, data, x, dq, tau, Convention::LOCAL);
    });
    measure("world", times, q, [&](const Vector &x) -> const Vector & {
        return pin::aba(model, data, x, dq, tau, Convention::WORLD);
    });
    measure("rnea", times, q, [&](const Vector &x) -> const Vector & {
        return pin::rnea(model, data, x, dq, tau);
    });
}
