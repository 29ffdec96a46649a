// Decks: TOML text + overrides -> checked values with their places in the file.
//
// Nothing here knows a key by name except deck_form.cpp and deck_rules.cpp; the keys come from
// schema.toml through the generated table (make_schema.py).
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

namespace rk {

// ---- schema ---------------------------------------------------------------------------------

enum class Type { text, integer, number, boolean, texts, integers, numbers };

// Holds if the value of `key` (of the same table, "table.key", or a fact) is one of `values`;
// without values, if a key of the same table is given.
struct Condition {
   std::string key;
   std::vector<std::string> values;
};

// A default that applies if all conditions hold
struct Choice {
   std::string toml; // as written in a deck
   std::vector<Condition> when;
};

// Values that are allowed only if all conditions hold
struct Restriction {
   std::vector<std::string> values; // as in a message
   std::vector<Condition> when;
   std::string why; // a reason for the message, or ""
};

constexpr int any_length = 0;
constexpr int dimension_length = -1; // of length scene.dimension
constexpr int unknowns_length = -2;  // one item for each unknown of a linear problem

struct KeySpec {
   std::string name;
   Type type;
   bool required = false;
   std::optional<std::string> default_toml; // as written in a deck
   std::vector<std::string> choices;        // numbers as text
   std::optional<double> min, max, above, below;
   int length = any_length;
   bool or_number = false, scalar = false, nonzero = false, infinite = false, unique = false, ascending = false;
   std::string refers_to;
   std::string expression; // what may stand in an expression: place, surface, time, energy; "" for none
   std::vector<Condition> required_if, only_if;
   std::vector<std::string> not_beside; // keys of the same table that exclude this one
   std::vector<std::string> as_many_as; // arrays of the same table, one of which is as long
   std::vector<Choice> default_if; // the first one whose conditions hold, before default_toml
   std::vector<Restriction> value_if;
};

struct TableSpec {
   std::string name; // empty for the keys outside every table
   bool many = false, required = false;
   std::string named_by;
   std::string not_beside; // a table that may replace this one
   std::size_t most = 1;   // maximum number of entries
   std::vector<std::string> needed_by, at_least;
   std::vector<Condition> only_if;
   std::vector<KeySpec> keys;

   const KeySpec *find(const std::string &key) const;
   std::string title() const; // as written in a deck: [name], [[name]]
};

// Generated: in the order of schema.toml, the keys outside every table first
const std::vector<TableSpec> &schema();
// deck.cpp: the table of a name, nullptr without; the names of all that have one
const TableSpec *find_table(const std::string &name);
std::vector<std::string> table_names();

// ---- document -------------------------------------------------------------------------------

// Place where something was written: a line of the deck, or an override
struct Origin {
   int line = 1;
   int column = 0;  // 0: the line suffices
   std::string set; // "--set key=value"; empty for the deck
};

struct Value {
   enum class Kind { text, integer, real, boolean, date, array, table };
   Kind kind = Kind::text;
   std::string text;
   std::int64_t integer = 0;
   double real = 0.0;
   bool boolean = false;
   std::vector<Value> items;
   Origin origin;
   bool by_default = false; // a default; its origin is that of the table

   Value() = default;
   explicit Value(std::string word) : text(std::move(word)) {}
   explicit Value(std::int64_t number) : kind(Kind::integer), integer(number) {}
   explicit Value(double number) : kind(Kind::real), real(number) {}
   // An array of such values
   template <typename T> Value(const std::vector<T> &list, const Origin &where) : kind(Kind::array), origin(where) {
      for (const T &one : list)
         items.emplace_back(one).origin = where;
   }
   bool is_number() const { return kind == Kind::integer || kind == Kind::real; }
   double number() const { return kind == Kind::integer ? static_cast<double>(integer) : real; }
   // As in a message or a condition: numbers and words plain, arrays in brackets
   std::string plain() const;
   // "a text", "an integer", ...
   const char *kind_name() const;
   // The value found, for "must be ..., not ...", or its kind where that is more helpful
   std::string described() const;
};

// One table of the deck, or one entry of an array of tables
struct Section {
   const TableSpec *spec = nullptr;
   int index = 0; // from 1; 0 for a single table
   Origin origin;
   std::map<std::string, Value> values;
   std::set<std::string> refused;                       // keys whose values were refused
   std::vector<std::pair<std::string, Origin>> unknown; // keys that are not in the schema

   const Value *find(const std::string &key) const;
   bool given(const std::string &key) const;       // including refused ones
   std::string text(const std::string &key) const; // "" if absent
};

enum class Status { good = 0, input = 2, file = 3 };

// A deck after reading; all its complaints, or its values
class Deck {
 public:
   Deck(std::string name, std::string text, std::vector<std::string> overrides);
   static Deck read(const std::string &path, std::vector<std::string> overrides);
   // Full name of the key that an override would set, with the name of its entry: material.fat.K
   // for material.K; "" if there is none: the message then has only the complaint about it
   std::string resolve(const std::string &key);
   // Complain about missing tables, if any, that a command needs
   void require(const std::string &command);

   // `address` is the key as a user would write it: material.fat.K
   void complain(const Origin &where, const std::string &address, const std::string &what);
   // The same for a key of a section, at its place if it is written, or for the section ("")
   void refuse(const Section &section, const std::string &key, const std::string &what);
   std::string where(const Origin &origin) const;
   std::string address(const Section &section, const std::string &key = "") const;
   const Section *single(const std::string &table) const;
   // The value of a key of a single table; nullptr if either is absent
   const Value *value(const std::string &table, const std::string &key) const;
   std::string word(const std::string &table, const std::string &key) const; // "" if absent
   int dimension() const;                                                     // 0 if absent
   std::vector<Section *> entries(const std::string &table);
   // Add a table that was not written, after others of its kind
   Section &add(const TableSpec &spec, const Origin &origin);
   // Index of the first section of a table, and the one after its last
   std::pair<std::size_t, std::size_t> range_of(const TableSpec &spec) const;
   // The value or fact of a condition, as plain text; "" if absent or refused
   std::string lookup(const Section &section, const std::string &key) const;

   std::string name, text, sha256, folder;
   std::vector<std::string> overrides;
   std::vector<Section> sections;   // in the order of the schema
   std::set<std::string> misshapen; // tables that have another type in the deck
   std::map<std::string, std::string> facts; // values derived from several keys, for conditions
   Status status = Status::good;
   std::string message; // all complaints, one per line, in the order of the deck

 private:
   explicit Deck(std::string path) : name(std::move(path)) {}
   struct Complaint {
      int order;
      std::string text;
   };
   std::vector<Complaint> complaints_;

   void load();
   void close();
};

// ---- steps (each adds to the deck's complaints) ----------------------------------------------

// deck_toml.cpp: text -> sections; false if it is not TOML
bool read_toml(Deck &deck);
// deck_toml.cpp: one TOML value; nothing if it is not one
std::optional<Value> parse_value(const std::string &text);
// deck_override.cpp
void apply_overrides(Deck &deck);
// deck_override.cpp: the result of resolve()
std::string full_key(Deck &deck, const std::string &address);
// deck_check.cpp: types, ranges, missing keys, defaults
void check_schema(Deck &deck);
// deck_form.cpp: set a default value
void put_default(Section &section, const std::string &key, Value value);
// deck_form.cpp: the form of scene.method, and other facts on which defaults depend
void choose_form(Deck &deck);
// deck_form.cpp: the title of a deck without one, from the name of its file
void choose_title(Deck &deck);
// deck_rules.cpp: rules that the schema cannot express
void check_rules(Deck &deck);

// deck_text.cpp
std::string sha256_hex(const std::string &bytes);
// "; did you mean 'x'?" if there is a similar word, otherwise "; <otherwise> a, b, c" (nothing if
// that is "")
std::string suggest(const std::string &word, const std::vector<std::string> &known,
                    const std::string &otherwise);
// "unknown key", and the most similar one or the table to which it belongs
std::string unknown_key(const TableSpec &table, const std::string &key);
std::string unknown_table(const std::string &name);
// Bytes of a file; if it cannot be read, nothing, and why
std::optional<std::string> read_bytes(const std::string &path, std::string &why);
bool is_blank(const std::string &text);
bool is_one_of(const std::string &word, const std::vector<std::string> &list);
std::string join(const std::vector<std::string> &words, const char *separator);
std::string quoted(const std::string &word);
// The text with control characters as JSON escapes
std::string escaped(const std::string &text);
// A number with the digits to read it back exactly
std::string exactly(double number);
// The word with control characters as escapes, truncated if it is very long
std::string shown(const std::string &word);

} // namespace rk
