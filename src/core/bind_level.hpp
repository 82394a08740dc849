// What the bindings of a level and of a whole fit share. A prepared model is read only, so that threads share it; a room
// belongs to a fit while it runs, and then waits for the next fit of its thread.
#pragma once

#include <chrono>
#include <memory>

#include "binding.hpp"
#include "fit.hpp"

// Takes the room of this thread for a fit, and gives it back. Between the steps of a fit Python may run a signal handler
// on the same thread, and that may fit as well: it finds the room taken, and makes one of its own.
class RoomOfThread {
  public:
    RoomOfThread();
    ~RoomOfThread();
    RoomOfThread(const RoomOfThread&) = delete;
    RoomOfThread& operator=(const RoomOfThread&) = delete;
    liaam::FitRoom& operator*() const { return *room_; }

  private:
    std::unique_ptr<liaam::FitRoom> room_;
};

// Asks Python, at most every 50 ms, whether a signal such as Ctrl-C has arrived. Also true while Python ends.
class Signals {
  public:
    bool operator()() {
        const auto now = std::chrono::steady_clock::now();
        if (now - last_ < std::chrono::milliseconds(50)) return raised_;
        last_ = now;
        if (Unlocked::ending()) return true;
        nb::gil_scoped_acquire locked;
        return raised_ = raised_ || PyErr_CheckSignals() != 0;
    }
    void rethrow() const {
        if (raised_) throw nb::python_error();
    }

  private:
    std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
    bool raised_ = false;
};

// The objective of a level, with the arrays that it views.
struct HeldObjective {
    liaam::Objective objective;
    std::vector<nb::object> kept;
};

// Takes named arrays of a dictionary, and keeps them alive.
class Fields {
  public:
    Fields(const nb::dict& given, std::vector<nb::object>& kept) : given_(given), kept_(kept) {}

    template <class T>
    std::span<const T> numbers(const char* name) {
        return span_of(array<T, 1>(name));
    }
    template <class T>
    liaam::MatrixView<const T> matrix(const char* name) {
        return view_of(array<T, 2>(name));
    }
    // Codes (parts, n k, w) of modes, and their scales (w).
    liaam::Modes modes(const char* codes, const char* scales) {
        const auto all = array<std::int16_t, 3>(codes);
        const std::size_t n_parts = all.shape(0), rows = all.shape(1), columns = all.shape(2);
        require(n_parts == 1 || n_parts == 3, "parts are constant, or constant, cos and sin");
        liaam::Modes found;
        for (std::size_t i = 0; i < n_parts; ++i) found.parts[i] = {data_of(all) + i * rows * columns, rows, columns};
        found.scales = numbers<float>(scales);
        require(columns % liaam::kEight == 0 && found.scales.size() == columns, "modes and their scales differ in size");
        return found;
    }
    template <class T>
    T value(const char* name) {
        return nb::cast<T>(given_[name]);
    }

  private:
    template <class T, std::size_t N>
    Array<T, N> array(const char* name) {
        nb::object given = given_[name];
        Array<T, N> found;
        if (!nb::try_cast(given, found, false))
            throw std::invalid_argument(std::string(name) + " has another type or number of axes, or is not contiguous");
        kept_.push_back(given);
        return found;
    }

    const nb::dict& given_;
    std::vector<nb::object>& kept_;
};

// The table of noise: standard deviations at evenly spaced logarithms, in order.
inline void check_noise(liaam::Floats table, double first_log, double last_log) {
    constexpr std::size_t kMost = std::size_t{1} << 20;  // places in it are counted in single precision
    require(table.size() >= 2 && table.size() <= kMost && last_log > first_log, "the table of noise is damaged");
}

liaam::Options options_of(const nb::dict& given);
