/* A number that counts what is done with it: additions, subtractions, multiplications, divisions, comparisons, changes
 * of sign and absolute values. Takes the place of a package's number type where that is compiled as C++. */
#ifndef COUNTED_HPP
#define COUNTED_HPP

#include <type_traits>

inline long counted_operations = 0;

struct counted {
    COUNTED_NUMBER value;

    counted() = default;
    counted(const counted &) = default;
    counted(const volatile counted &x) : value(x.value)
    {
    }
    counted &operator=(const counted &) = default;
    template <class T, class = std::enable_if_t<std::is_arithmetic_v<T> || std::is_enum_v<T>>>
    constexpr counted(T x) : value(static_cast<COUNTED_NUMBER>(x))
    {
    }
    template <class T, class = std::enable_if_t<std::is_arithmetic_v<T>>> constexpr explicit operator T() const
    {
        return static_cast<T>(value);
    }

#define COUNTED(op, type)                                                                                              \
    friend type operator op(counted a, counted b)                                                                      \
    {                                                                                                                  \
        counted_operations++;                                                                                          \
        return a.value op b.value;                                                                                     \
    }
    COUNTED(+, counted)
    COUNTED(-, counted)
    COUNTED(*, counted)
    COUNTED(/, counted)
    COUNTED(<, bool)
    COUNTED(>, bool)
    COUNTED(<=, bool)
    COUNTED(>=, bool)
    COUNTED(==, bool)
    COUNTED(!=, bool)
#undef COUNTED

    friend constexpr counted operator-(counted a)
    {
        return counted(-a.value);
    }
    counted &operator+=(counted b)
    {
        return *this = *this + b;
    }
    counted &operator-=(counted b)
    {
        return *this = *this - b;
    }
    counted &operator*=(counted b)
    {
        return *this = *this * b;
    }
    counted &operator/=(counted b)
    {
        return *this = *this / b;
    }
};

inline counted counted_fabs(counted a)
{
    counted_operations++;
    return a.value < 0 ? counted(-a.value) : a;
}

#endif
