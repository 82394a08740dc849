// What all files of bindings share: arrays in and out. Sizes and types are checked here and nowhere else.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "arrays.hpp"
#include "encoding.hpp"
#include "image.hpp"

namespace nb = nanobind;
using namespace nb::literals;

template <class T, std::size_t N>
using Array = nb::ndarray<const T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;
template <class T>
using Image = nb::ndarray<const T, nb::shape<-1, -1, 3>, nb::device::cpu>;  // of any strides

// Releases Python's lock while it lives. Python ends a thread that asks for the lock while Python itself ends, and in
// the midst of C++ that aborts the process (before Python 3.14). So such a thread waits for the end, without the lock.
class Unlocked {
  public:
    Unlocked();
    ~Unlocked();
    Unlocked(const Unlocked&) = delete;
    Unlocked& operator=(const Unlocked&) = delete;
    static bool ending();  // whether Python ends, so that no other thread may ask for the lock any more
    static void end();     // for atexit: waits for the threads that run without the lock

  private:
    PyThreadState* state_;
};

inline void require(bool holds, const char* fault) {
    if (!holds) throw std::invalid_argument(fault);
}

// An enumerated value from its number, of which `last` is the largest.
template <class Value>
Value numbered(int number, Value last, const char* name) {
    if (number < 0 || number > static_cast<int>(last))
        throw std::invalid_argument(std::string("there is no ") + name + " of number " + std::to_string(number));
    return static_cast<Value>(number);
}

// The numbers of an array. All bindings take them from here: the core may assume that each begins at a multiple of its
// alignment, which views of bytes need not do.
template <class Given>
auto* data_of(const Given& array) {
    auto* numbers = array.data();
    using Number = std::remove_pointer_t<decltype(numbers)>;
    require(array.size() == 0 || reinterpret_cast<std::uintptr_t>(numbers) % alignof(Number) == 0,
            "the numbers of an array are not aligned in memory; give a copy of the array");
    return numbers;
}

// The number of entries of an array that is to be made: what does not fit into memory's addresses is refused, before a
// product wraps around.
inline std::size_t size_of(std::initializer_list<std::size_t> shape) {
    constexpr std::size_t kMost = std::numeric_limits<std::ptrdiff_t>::max() / sizeof(double);
    std::size_t size = 1;
    for (const std::size_t side : shape) {
        require(side == 0 || size <= kMost / side, "the array that is asked for is too large");
        size *= side;
    }
    return size;
}

// A NumPy array of the given shape that owns the numbers.
template <class T>
nb::object owned(std::vector<T>&& numbers, std::initializer_list<std::size_t> shape) {
    auto* kept = new std::vector<T>(std::move(numbers));
    nb::capsule owner(kept, [](void* each) noexcept { delete static_cast<std::vector<T>*>(each); });
    const nb::ndarray<nb::numpy, T> array(kept->data(), shape, owner);
    return nb::cast(array, nb::rv_policy::reference);  // another policy would copy
}
template <class T>
nb::object copied(const std::vector<T>& numbers, std::initializer_list<std::size_t> shape) {
    return owned(std::vector<T>(numbers), shape);
}
inline nb::object copied(const liaam::Matrix& matrix) {
    return copied(matrix.numbers(), {matrix.rows(), matrix.columns()});
}

template <class T>
std::span<const T> span_of(const Array<T, 1>& array) {
    return {data_of(array), array.shape(0)};
}
template <class Given>
auto numbers_of(const Given& array) {
    const auto* numbers = data_of(array);
    return std::vector<std::remove_cv_t<std::remove_pointer_t<decltype(numbers)>>>(numbers, numbers + array.size());
}
template <class T>
liaam::MatrixView<const T> view_of(const Array<T, 2>& array) {
    return {data_of(array), array.shape(0), array.shape(1)};
}
inline liaam::Matrix matrix_of(const Array<double, 2>& array) {
    liaam::Matrix matrix(array.shape(0), array.shape(1));
    std::copy_n(data_of(array), array.size(), matrix.numbers().begin());
    return matrix;
}

// A table of light has four numbers for each channel and stored value.
template <class T>
void check_table(const Array<float, 3>& table) {
    require(table.shape(0) == 3 && table.shape(1) == std::size_t{1} << (8 * sizeof(T)) && table.shape(2) == 4,
            "the table has an entry for each stored value");
}

template <class T>
liaam::Stored<T> stored(const Image<T>& image) {
    return {data_of(image), static_cast<std::ptrdiff_t>(image.shape(0)), static_cast<std::ptrdiff_t>(image.shape(1)),
            image.stride(0), image.stride(1), image.stride(2)};
}

// The constants that liaam._core has set.
const liaam::EncodingConstants& encoding_constants();

void bind_level(nb::module_& module);
void bind_fit(nb::module_& module);
void bind_images(nb::module_& module);
void bind_parts(nb::module_& module);
