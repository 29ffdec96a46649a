// Expressions in coordinates or invariants, as decks hold them: numbers, names, arithmetic, comparisons
// and functions; nothing that could act on anything.
#pragma once

#include <string>
#include <vector>

namespace rk {

// Names of the values that an expression may be asked for, in the order in which they come
const std::vector<std::string> &expression_names();

// Why a text is not an expression in these names and functions of one value, with the place of the
// mistake; "" where it is one
std::string expression_fault(const std::string &text, const std::vector<std::string> &names);

// The names that occur in an expression, each with blanks around it; "" where it is none
std::string names_in(const std::string &text);

// Operations of an energy in the order in which they are computed. A value has no operation where it
// is a name or a number, otherwise one on one or two values before it
struct Tape {
   std::vector<int> operation, left, right; // numbers of values from 0, -1 where there is none
   std::vector<double> number;
   int result = -1;
   std::string fault; // why the text is not an expression; "" where it is one
};

// Names of what an energy depends on: the first values of its tape, before its constants
const std::vector<std::string> &energy_names();

Tape energy_tape(const std::string &text, const std::vector<std::string> &constants);

} // namespace rk
