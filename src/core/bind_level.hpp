// What the bindings of a level and of a whole fit share. A prepared model is read only, so that threads share it; the
// room belongs to a thread.
#pragma once

#include <chrono>

#include "binding.hpp"
#include "fit.hpp"

liaam::FitRoom& room();

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
    liaam::Rows<const T> rows(const char* name) {
        return rows_of(array<T, 2>(name));
    }
    std::array<liaam::Rows<const float>, 3> parts(const char* name) {
        const auto all = array<float, 3>(name);
        if (all.size() == 0) return {};
        const std::size_t rows = all.shape(1), columns = all.shape(2), size = rows * columns;
        require(all.shape(0) == 3, "parts are constant, cos and sin");
        return {{{all.data(), rows, columns}, {all.data() + size, rows, columns}, {all.data() + 2 * size, rows, columns}}};
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

liaam::Options options_of(const nb::dict& given);
