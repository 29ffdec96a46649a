// Expressions by muParser, compiled once per text and thread, and tapes of energies.
#include "expression.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <cmath>
#include <cstring>
#include <iterator>
#include <limits>
#include <memory>
#include <regex>
#include <sstream>
#include <unordered_map>

#include <muParser.h>

namespace rk {

// Maximum number of compiled expressions stored by a thread
constexpr std::size_t most_kept = 256;

constexpr std::size_t name_count = 9;

const std::vector<std::string> &expression_names() {
   static const std::vector<std::string> names = {"x", "y", "z", "r", "theta", "t", "nx", "ny", "nz"};
   return names;
}

static double both(double a, double b) { return a != 0.0 && b != 0.0 ? 1.0 : 0.0; }
static double either(double a, double b) { return a != 0.0 || b != 0.0 ? 1.0 : 0.0; }
static double negated(double a) { return a == 0.0 ? 1.0 : 0.0; }

namespace {

struct Compiled {
   std::array<double, name_count> place{};
   mu::Parser parser;

   Compiled(const std::string &text, const std::vector<std::string> &names) {
      parser.ClearConst();
      parser.DefineConst("pi", std::acos(-1.0));
      parser.DefineOprt("and", both, mu::prLAND, mu::oaLEFT);
      parser.DefineOprt("or", either, mu::prLOR, mu::oaLEFT);
      parser.DefineFun("not", negated);
      const std::vector<std::string> &all = expression_names();
      for (const std::string &name : names) {
         const auto at = static_cast<std::size_t>(
            std::find(all.begin(), all.end(), name) - all.begin());
         parser.DefineVar(name, &place.at(at));
      }
      parser.SetExpr(text);
   }
};

} // namespace

// "one of x, y, pi and the functions sin, ..."
static std::string known(const mu::Parser &parser, const std::vector<std::string> &names) {
   std::string list;
   for (const std::string &name : names)
      list += name + ", ";
   list += "pi; functions are ";
   bool first = true;
   for (const auto &[name, unused] : parser.GetFunDef()) {
      list += (first ? "" : ", ") + name;
      first = false;
   }
   return list;
}

// Faults that are detected before the parser reads a text; "" if there are none
static std::string first_fault(const std::string &text) {
   const auto at = [](std::size_t position) {
      return " at position " + std::to_string(position);
   };
   if (text.find('"') != std::string::npos)
      return "is not an expression: a text in quotes" + at(text.find('"'));
   // a single = would assign to a name
   static const std::regex single("(^|[^=!<>])=(?!=)");
   std::smatch found;
   if (std::regex_search(text, found, single))
      return "is not an expression: = sets a value" + at(found.position() + found.length(1)) +
             ", == compares";
   return "";
}

// Fault found by a parser, with the known names if it met an unknown one
static std::string parser_fault(const mu::Parser::exception_type &fault, const std::string &known_words) {
   const bool unknown = fault.GetCode() == mu::ecUNASSIGNABLE_TOKEN;
   const std::string power = fault.GetExpr().find("**") == std::string::npos ? "" : "; a power is written ^";
   return "is not an expression: " + fault.GetMsg() + power + (unknown ? " Names are " + known_words : "");
}

static const char *const several_values =
   "is not an expression: several values with commas between, one is needed";

std::string expression_fault(const std::string &text, const std::vector<std::string> &names) {
   const std::string seen = first_fault(text);
   if (!seen.empty())
      return seen;
   try {
      Compiled compiled(text, names);
      compiled.parser.Eval();
      return compiled.parser.GetNumResults() > 1 ? several_values : "";
   } catch (const mu::Parser::exception_type &fault) {
      return parser_fault(fault, known(Compiled("0", names).parser, names));
   }
}

const std::vector<std::string> &energy_names() {
   static const std::vector<std::string> names = {"I1", "I2", "I4", "activation"};
   return names;
}

// ---- energies: the parser evaluates indices of values, and each operation is recorded ----------

// Operations, in the order of their numbers in rk_tape.f90
enum Operation {
   no_operation, plus, minus, times, over, power, less, greater, at_most, at_least, largest, smallest,
   negative, exponential, logarithm, root, sine, cosine, sinus_h, cosinus_h, tangens_h, magnitude
};

static thread_local Tape *recorded = nullptr;

static double record(int operation, double left, double right, double number = 0.0) {
   recorded->operation.push_back(operation);
   recorded->left.push_back(static_cast<int>(left));
   recorded->right.push_back(static_cast<int>(right));
   recorded->number.push_back(number);
   return static_cast<double>(recorded->operation.size() - 1);
}

template <int operation> double of_two(double a, double b) { return record(operation, a, b); }
template <int operation> double of_one(double a) { return record(operation, a, -1); }

// A number literal
static int literal(const char *text, int *position, double *value) {
   const char *const end = text + std::strlen(text);
   double number = 0.0;
   if (!std::isdigit(static_cast<unsigned char>(*text)) && *text != '.')
      return 0;
   const auto [after, wrong] = std::from_chars(text, end, number);
   if (wrong != std::errc())
      return 0;
   *position += static_cast<int>(after - text);
   *value = record(no_operation, -1, -1, number);
   return 1;
}

Tape energy_tape(const std::string &text, const std::vector<std::string> &constants) {
   Tape tape;
   recorded = &tape;
   tape.fault = first_fault(text);
   if (!tape.fault.empty())
      return tape;
   mu::Parser parser;
   parser.EnableBuiltInOprt(false);
   parser.ClearFun();
   parser.ClearInfixOprt();
   parser.ClearConst();
   parser.AddValIdent(literal);
   parser.DefineInfixOprt("-", of_one<negative>, mu::prINFIX, false);
   parser.DefineOprt("+", of_two<plus>, mu::prADD_SUB);
   parser.DefineOprt("-", of_two<minus>, mu::prADD_SUB);
   parser.DefineOprt("*", of_two<times>, mu::prMUL_DIV);
   parser.DefineOprt("/", of_two<over>, mu::prMUL_DIV);
   parser.DefineOprt("^", of_two<power>, mu::prPOW, mu::oaRIGHT);
   parser.DefineOprt("<", of_two<less>, mu::prCMP);
   parser.DefineOprt(">", of_two<greater>, mu::prCMP);
   parser.DefineOprt("<=", of_two<at_most>, mu::prCMP);
   parser.DefineOprt(">=", of_two<at_least>, mu::prCMP);
   parser.DefineFun("max", of_two<largest>, false);
   parser.DefineFun("min", of_two<smallest>, false);
   parser.DefineFun("exp", of_one<exponential>, false);
   parser.DefineFun("ln", of_one<logarithm>, false);
   parser.DefineFun("log", of_one<logarithm>, false);
   parser.DefineFun("sqrt", of_one<root>, false);
   parser.DefineFun("sin", of_one<sine>, false);
   parser.DefineFun("cos", of_one<cosine>, false);
   parser.DefineFun("sinh", of_one<sinus_h>, false);
   parser.DefineFun("cosh", of_one<cosinus_h>, false);
   parser.DefineFun("tanh", of_one<tangens_h>, false);
   parser.DefineFun("abs", of_one<magnitude>, false);
   std::vector<std::string> names = energy_names();
   names.insert(names.end(), constants.begin(), constants.end());
   std::vector<double> value(names.size() + 1);
   for (std::size_t i = 0; i < names.size(); ++i) {
      value[i] = record(no_operation, -1, -1);
      parser.DefineVar(names[i], &value[i]);
   }
   value.back() = record(no_operation, -1, -1, std::acos(-1.0));
   parser.DefineVar("pi", &value.back());
   try {
      parser.SetExpr(text);
      tape.result = static_cast<int>(parser.Eval());
      if (parser.GetNumResults() > 1)
         tape.fault = several_values;
      else if (text.find('?') != std::string::npos)
         tape.fault = "is not an energy: write max(a, b), min(a, b) or (I4 > 1)*a instead of c ? a : b";
   } catch (const mu::Parser::exception_type &fault) {
      tape.fault = parser_fault(fault, known(parser, names));
   }
   return tape;
}

std::string names_in(const std::string &text) {
   std::string found = " ";
   try {
      Compiled compiled(text, expression_names()); // the names must live as long as the parser
      for (const auto &used : compiled.parser.GetUsedVar())
         found += used.first + " ";
   } catch (const mu::Parser::exception_type &) {
      // the check of the deck reports the fault
      return "";
   }
   return found;
}

// Compiled expressions by their text
using Kept = std::unordered_map<std::string, std::unique_ptr<Compiled>>;

} // namespace rk

extern "C" {

// Value of an expression for these values of its names, compiled on first use; NaN if it is not an
// expression
double rk_expression_value(const char *text, const double *values) {
   thread_local rk::Kept kept;
   try {
      auto found = kept.find(text);
      if (found == kept.end()) {
         if (kept.size() >= rk::most_kept)
            kept.clear();
         found = kept.emplace(text, std::make_unique<rk::Compiled>(text, rk::expression_names())).first;
      }
      std::copy(values, values + rk::name_count, found->second->place.begin());
      return found->second->parser.Eval();
   } catch (const mu::Parser::exception_type &) {
      return std::numeric_limits<double>::quiet_NaN();
   }
}

const char *rk_expression_names(const char *text) {
   thread_local std::string names;
   names = rk::names_in(text);
   return names.c_str();
}

// Tape of an energy, whose constants have names separated by blanks, with `most` values at most;
// returns the fault, or ""
const char *rk_energy_tape(const char *text, const char *constants, int most, int *count, int *operation,
                           int *left, int *right, double *number, int *result) {
   thread_local std::string fault;
   std::istringstream words(constants);
   const std::vector<std::string> names{std::istream_iterator<std::string>(words), {}};
   const rk::Tape tape = rk::energy_tape(text, names);
   *count = static_cast<int>(tape.operation.size());
   fault = tape.fault;
   if (fault.empty() && *count > most)
      fault = "is too long: " + std::to_string(*count) + " numbers, names and operations, of at most " +
              std::to_string(most);
   if (!fault.empty())
      return fault.c_str();
   std::copy(tape.operation.begin(), tape.operation.end(), operation);
   std::copy(tape.left.begin(), tape.left.end(), left);
   std::copy(tape.right.begin(), tape.right.end(), right);
   std::copy(tape.number.begin(), tape.number.end(), number);
   *result = tape.result;
   return fault.c_str();
}

} // extern "C"
