// Expressions in coordinates or invariants, as in decks: numbers, names, arithmetic, comparisons
// and functions; none of them has side effects.
#pragma once

#include <string>
#include <vector>

namespace rk {

// Names of the values that an expression may use, in the order of the values passed
const std::vector<std::string> &expression_names();

// Why a text is not an expression in these names and functions of one value, with the place of the
// error; "" if it is one
std::string expression_fault(const std::string &text, const std::vector<std::string> &names);

// The names that occur in an expression, each with blanks around it; "" if it is not an expression
std::string names_in(const std::string &text);

// Operations of an energy in the order in which they are computed. A value that is a name or a
// number has no operation, any other has one on one or two values before it
struct Tape {
   std::vector<int> operation, left, right; // indices of values from 0, -1 if there is none
   std::vector<double> number;
   int result = -1;
   std::string fault; // why the text is not an expression; "" if it is one
};

// Names of the variables of an energy: the first values of its tape, before its constants
const std::vector<std::string> &energy_names();

Tape energy_tape(const std::string &text, const std::vector<std::string> &constants);

} // namespace rk
