// Views and matrices that the other files share.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace liaam {

using Floats = std::span<const float>;
using Doubles = std::span<const double>;

// A view of a C-contiguous matrix.
template <class T>
struct MatrixView {
    T* data = nullptr;
    std::size_t n_rows = 0;
    std::size_t n_columns = 0;

    std::span<T> operator[](std::size_t i) const { return {data + i * n_columns, n_columns}; }
    bool empty() const { return n_rows == 0 || n_columns == 0; }
};

// A matrix of doubles that owns its numbers; resizing keeps the memory.
class Matrix {
  public:
    Matrix() = default;
    Matrix(std::size_t rows, std::size_t columns) { resize(rows, columns); }

    void resize(std::size_t rows, std::size_t columns) {
        rows_ = rows;
        columns_ = columns;
        numbers_.resize(rows * columns);
    }
    void fill(double value) { std::fill(numbers_.begin(), numbers_.end(), value); }

    std::size_t rows() const { return rows_; }
    std::size_t columns() const { return columns_; }
    double* operator[](std::size_t i) { return numbers_.data() + i * columns_; }
    const double* operator[](std::size_t i) const { return numbers_.data() + i * columns_; }
    MatrixView<const double> view() const { return {numbers_.data(), rows_, columns_}; }
    std::vector<double>& numbers() { return numbers_; }
    const std::vector<double>& numbers() const { return numbers_; }

  private:
    std::size_t rows_ = 0;
    std::size_t columns_ = 0;
    std::vector<double> numbers_;
};

}  // namespace liaam
