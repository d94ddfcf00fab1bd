// participant.hpp: the participant of participant.h in C++17. Values are spans, errors are exceptions.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

extern "C" {
#include "participant.h"
}

namespace cosim {

// The values of a message (std::span needs C++20).
template <typename T> class Values {
  public:
    Values(T *data, std::size_t size) : data_(data), size_(size) {}
    T &operator[](std::size_t i) const { return i < size_ ? data_[i] : throw std::out_of_range("value of a message"); }
    std::size_t size() const { return size_; }
    T *begin() const { return data_; }
    T *end() const { return data_ + size_; }

  private:
    T *data_;
    std::size_t size_;
};

// What a law sees of its node in one slot.
class Slot {
  public:
    Slot(participant_t *p, double t, double h) : t(t), h(h), p_(p) {}
    const double t, h; // s: time of the run, length of the slot

    // The values accepted last of a received message, by its number in table.h or its name.
    Values<const double> in(int32_t i) const { return {participant_input(p_, i), width(table().received, table().n_received, i)}; }
    Values<const double> in(std::string_view name) const { return in(find(table().received, table().n_received, name)); }
    // The values of a message that is sent.
    Values<double> out(int32_t i) const { return {participant_output(p_, i), width(table().sent, table().n_sent, i)}; }
    Values<double> out(std::string_view name) const { return out(find(table().sent, table().n_sent, name)); }
    double scale() const { return participant_scale(p_); }                   // of torques, see participant.h
    bool received(int32_t i) const { return p_->inputs[i].newest >= 0; }      // a sample of the run has come
    const participant_t &participant() const { return *p_; }
    void stop() const { participant_command(p_, COMMAND_STOP); }
    void estop() const { participant_estop(p_); }

  private:
    const participant_table_t &table() const { return *p_->table; }
    template <typename M> static std::size_t width(const M *messages, int32_t n, int32_t i)
    {
        if (i < 0 || i >= n) throw std::out_of_range("number of a message");
        return static_cast<std::size_t>(messages[i].layout.n_fields);
    }
    template <typename M> static int32_t find(const M *messages, int32_t n, std::string_view name)
    {
        for (int32_t i = 0; i < n; i++)
            if (name == messages[i].name) return i;
        throw std::out_of_range("no message " + std::string(name));
    }
    participant_t *p_;
};

using Law = std::function<void(const Slot &)>;
using Send = std::function<void(int32_t bus, const frame_t &frame, const char *key)>;

// A participant with a transport of its own: feed it with hear(), call poll() when it is time.
class Participant {
  public:
    Participant(const participant_table_t &table, Send send, Law law)
        : send_(std::move(send)), law_(std::move(law)), p_(std::make_unique<participant_t>())
    {
        participant_init(p_.get(), &table, &Participant::send, &Participant::step, this);
    }
    Participant(const Participant &) = delete;
    Participant &operator=(const Participant &) = delete;
    ~Participant() { participant_end(p_.get()); } // torque 0, and a last heartbeat

    void hear(const frame_t &frame) { participant_hear(p_.get(), &frame); }
    int64_t poll(int64_t now_ns) { return participant_poll(p_.get(), now_ns); } // until when, ns; -1: the end
    bool ready() const { return participant_ready(p_.get()) != 0; }
    participant_t *get() { return p_.get(); }

  private:
    static void send(void *self, int32_t bus, const frame_t *frame, const char *key)
    {
        static_cast<Participant *>(self)->send_(bus, *frame, key);
    }
    static void step(void *self, participant_t *p, double t, double h)
    {
        static_cast<Participant *>(self)->law_(Slot(p, t, h));
    }
    Send send_;
    Law law_;
    std::unique_ptr<participant_t> p_;
};

// A loop in C, run_on_can or run_on_zenoh, with a law in C++. An exception of the law stops the node, and is
// thrown again when the loop has ended.
template <typename Loop> int run(Loop loop, int argc, char **argv, const participant_table_t &table, const Law &law)
{
    struct Call {
        const Law &law;
        std::exception_ptr failed;
    } call{law, nullptr};
    auto step = [](void *context, participant_t *p, double t, double h) {
        auto &made = *static_cast<Call *>(context);
        try {
            if (!made.failed) made.law(Slot(p, t, h));
        } catch (...) {
            made.failed = std::current_exception();
            p->life.now |= WHY_COMPONENT;
            participant_command(p, COMMAND_STOP);
        }
    };
    const int code = loop(argc, argv, &table, step, &call);
    if (call.failed) std::rethrow_exception(call.failed);
    return code;
}

} // namespace cosim
